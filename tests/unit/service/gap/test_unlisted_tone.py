"""A tone at a frequency of its own is found in the scatter; what rings, what noise drives, and noise are none."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.overall_verdict import with_tone
from service.gap.unlisted_tone import Tone, unlisted_tone
from service.gap.weighing.verdict import Verdict
from sim.reference import reference_rig
from tests.unit.service.gap.measured.test_coherent import played

RIG = reference_rig()
AXES = ("xA", "xB", "yA", "yB")


def pair(hz: float, amplitude_m: float = 5e-9, other_hz: float | None = None) -> tuple[Sweep, Sweep]:
    return played(amplitude_m, hz, seed=1)[0], played(amplitude_m, hz if other_hz is None else other_hz, seed=2)[0]


@pytest.mark.parametrize("hz", [23.7, 73.4, 130.6])
def test_a_tone_is_found_where_it_is_and_as_large_as_it_is(hz: float) -> None:
    tone = unlisted_tone((), *pair(hz), RIG)
    assert tone is not None
    assert tone.frequency_hz == pytest.approx(hz, abs=0.4)
    assert tone.amplitude_m == pytest.approx(np.full(4, 5e-9), rel=0.2)
    assert f"at {tone.frequency_hz:.4g} Hz" in tone.in_words(AXES)
    assert " um in " in tone.in_words(AXES)


@pytest.mark.parametrize("hz", [141.3, 171.7, 213.3])
def test_a_loud_tone_between_lines_is_found_by_its_leakage(hz: float) -> None:
    """In blocks of 0.5 s lines are too far apart for three to come near; phases alone fit other frequencies, too."""
    main, other = (played(3e-7, hz, seed, block_s=0.5)[0] for seed in (1, 2))
    tone = unlisted_tone((), main, other, RIG)
    assert tone is not None
    assert tone.frequency_hz == pytest.approx(hz, abs=0.01)
    assert tone.amplitude_m == pytest.approx(np.full(4, 3e-7), rel=0.02)


@pytest.mark.parametrize("hz", [141.3, 171.7, 213.3])
def test_the_leakage_of_a_listed_tone_is_no_other_one(hz: float) -> None:
    main, other = (replace(played(3e-7, hz, s, block_s=0.5)[0], speed_rad_s=np.pi * hz) for s in (1, 2))
    assert unlisted_tone((), main, other, RIG) is None


def test_noise_has_none() -> None:
    for seed in range(5):
        for block_s in (0.05, 0.5):
            quiet = [played(0.0, 50.0, seed=2 * seed + k, block_s=block_s)[1] for k in range(2)]
            assert unlisted_tone((), *quiet, RIG) is None


@pytest.mark.parametrize("hz", [50.0, 150.0, 46.0, 92.0])
def test_multiples_of_the_mains_and_of_the_speed_are_listed(hz: float) -> None:
    main, other = pair(hz)
    assert unlisted_tone((), replace(main, speed_rad_s=2 * np.pi * 46.0), other, RIG) is None


def test_what_the_other_sweep_does_not_show_is_none() -> None:
    assert unlisted_tone((), *pair(73.4, other_hz=120.0), RIG) is None
    main, other = pair(73.4, other_hz=120.0)
    assert unlisted_tone((), main, replace(other, block_samples=None), RIG) is not None


def resonating(hz: float, damping_ratio: float, seed: int, rings: bool, block_s: float = 0.05) -> Sweep:
    """A sweep whose blocks have a resonance: of the step to each point, in its own size, or driven by noise."""
    _, quiet = played(0.0, hz, seed, block_s)
    rng = np.random.default_rng(seed)
    Y, rate = quiet.Y.copy(), quiet.sample_rate_hz
    assert quiet.block_samples is not None
    for p, n in enumerate(quiet.block_samples.tolist()):
        s = 2 * np.pi * hz * (1j - damping_ratio) / rate
        t = np.arange(n * Y.shape[1])
        size = 20e-9 * np.exp(rng.standard_normal()) / max(abs(quiet.frequency_hz[p] / hz - 1), 0.05)
        if rings:
            x = 0.02 * size * np.exp(s * t + 1j * rng.uniform(0, 6))
        else:
            start = np.sqrt(1 / (1 - np.exp(2 * s.real))) * rng.standard_normal(2) @ (1, 1j)
            kicks = np.r_[start, (rng.standard_normal((len(t) - 1, 2)) @ (1, 1j))]
            turned = np.cumsum(kicks * np.exp(-s * t)) * np.exp(s * t)
            x = 5e-9 * turned * np.sqrt(1 - np.exp(2 * s.real))
        for j, h in enumerate(quiet.harmonics):
            basis = np.exp(-2j * np.pi * h * quiet.frequency_hz[p] / rate * t) * (2 if h else 1) / n
            Y[p, :, j] += (basis * x.real).reshape(-1, n).sum(axis=1)[:, None]
    return replace(quiet, Y=Y)


@pytest.mark.parametrize("rings", [True, False], ids=["rings", "driven by noise"])
@pytest.mark.parametrize("damping_ratio", [0.001, 0.01, 0.05])
@pytest.mark.parametrize("hz", [36.3, 73.4, 131.0])
def test_a_resonance_is_no_tone(hz: float, damping_ratio: float, rings: bool) -> None:
    for seed in range(2):
        sweeps = (resonating(hz, damping_ratio, 2 * seed + k, rings) for k in (1, 2))
        assert unlisted_tone((), *sweeps, RIG) is None


@pytest.mark.parametrize(("rings", "damping_ratio"), [(True, 1e-4), (True, 1e-3), (False, 1e-4)])
def test_nor_is_a_loud_one_whose_leakage_reaches_far(rings: bool, damping_ratio: float) -> None:
    quiet = [played(0.0, 131.0, seed, 0.3)[1] for seed in (1, 2)]
    faint = [resonating(131.0, damping_ratio, seed, rings, 0.3) for seed in (1, 2)]
    loud = [replace(s, Y=q.Y + 100 * (s.Y - q.Y)) for s, q in zip(faint, quiet, strict=True)]
    assert unlisted_tone((), loud[0], loud[1], RIG) is None


def test_it_is_none_of_these_where_nothing_else_is_wrong_and_effects_stand_beside_it() -> None:
    words = Tone(73.4, np.array([1e-7, 3e-7, 0.0, 0.0])).in_words(AXES)
    assert words.startswith("a tone of 0.3 um in xB at 73.4 Hz")
    alone = with_tone(Verdict("no_gap", (), (), 0.9, ()), words)
    assert (alone.kind, alone.unexplained, alone.reasons) == ("none_of_these", "additive", (f"signals: {words}",))
    unknown = Verdict("none_of_these", (), (), 0.9, ("plant: leaves 80 % of the gap",), unexplained="plant")
    assert with_tone(unknown, words).reasons == (*unknown.reasons, f"signals: {words}")
    assert with_tone(unknown, words).unexplained == "plant"
    named = Verdict("effect", ("sensor_lag",), (), 0.8, ())
    assert with_tone(named, words) is named
