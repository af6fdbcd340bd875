"""What nothing explains is told of the part where it is, and of what can be at fault there."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.diagnose import diagnose
from service.gap.document import gap_document
from service.gap.explain_parts import explain_parts
from service.gap.fitting.candidates import Fitter
from service.gap.observed import observed
from service.gap.progress import Progress
from service.gap.where.where import locate
from sim.rig import Rig
from sim.twin import linear_model, with_effects
from tests.support.synthetic import HARMONICS, experiment, known_datasheet, true_rig
from tests.support.two_axes import one_plane

pytestmark = pytest.mark.slow


def answering(rig: Rig, s: Sweep, amplifiers: np.ndarray | float = 1.0, rotor: np.ndarray | float = 1.0) -> Sweep:
    """The sweep of a rig whose amplifiers and rotor answer so many times as much at each line, in closed loop."""
    frequency, line = np.unique(s.frequency_hz, return_inverse=True)
    m, f = linear_model(rig, frequency), HARMONICS.index(1)
    R, C = s.R.mean(axis=1)[:, f, :, None], m.controller[:, None, None]

    def signals(A: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, ...]:
        U = np.linalg.solve(np.eye(rig.n_axes) + C * P @ A, np.eye(rig.n_axes))[line] @ R
        I = A[line] @ U
        return U, I, P[line] @ I

    out = []
    times = [np.broadcast_to(x, len(frequency))[:, None, None] for x in (amplifiers, rotor)]
    changed, plain = signals(times[0] * m.i_per_u, times[1] * m.y_per_i), signals(m.i_per_u, m.y_per_i)
    for X, now, before in zip((s.U, s.I, s.Y), changed, plain, strict=True):
        X = X.copy()
        X[:, :, f] += (now - before)[:, None, :, 0]
        out.append(X)
    return replace(s, U=out[0], I=out[1], Y=out[2])


def with_stalling_amplifiers(rig: Rig, s: Sweep) -> Sweep:
    """The sweep of a rig whose amplifiers hardly answer above 600 Hz, in closed loop."""
    return answering(rig, s, amplifiers=np.where(np.unique(s.frequency_hz) > 600.0, 0.4 * np.exp(-2j), 1.0))


def test_amplifiers_that_nothing_explains_are_no_datasheet_of_another_rig() -> None:
    """They draw their values as far as they go, but the rotor is the datasheet's. More data explain them no better."""
    datasheet, truth = known_datasheet(seed=35)
    rig = true_rig(truth)
    measured = experiment(rig)
    sweeps = tuple(with_stalling_amplifiers(rig, s) for s in measured.sweeps)
    found = gap_document(diagnose(*one_plane(replace(measured, sweeps=sweeps), datasheet)))
    verdict = found["verdict"]
    assert verdict["kind"] == "none_of_these"
    assert verdict["reasons"][0].startswith("amplifier: ")
    assert "another rig" not in " ".join(verdict["reasons"])
    assert "wrong in the amplifier no known effect explains" in verdict["sentence"]
    assert not any("were fitted too" in note for note in found["notes"])


def with_a_little_everywhere(s: Sweep, size_a: float, seed: int) -> Sweep:
    """The sweep with currents that are off by so much in every point, harmonic and channel, as a small dead band is."""
    rng = np.random.default_rng(seed)
    I = np.array(s.I)
    off = rng.standard_normal((len(I), 1, *I.shape[2:])) + 1j * rng.standard_normal((len(I), 1, *I.shape[2:]))
    off[:, :, 0] = off[:, :, 0].real
    return replace(s, I=I + size_a * off)


@pytest.mark.parametrize(("size_a", "kind"), [(0.0, "no_gap"), (6e-5, "none_of_these")])
def test_what_no_band_shows_but_all_of_them_together_is_no_noise(size_a: float, kind: str) -> None:
    """Off by less than the mean's noise everywhere; no band of the fitted sweep leaves eight deviates."""
    datasheet, truth = known_datasheet(seed=35)
    measured = experiment(true_rig(truth))
    sweeps = tuple(with_a_little_everywhere(s, size_a, k) for k, s in enumerate(measured.sweeps))
    verdict = diagnose(replace(measured, sweeps=sweeps), datasheet).verdict
    assert (verdict.kind, verdict.unexplained) == (kind, "amplifier" if kind == "none_of_these" else None)


@pytest.mark.parametrize("share", [0.0, 3e-3])
def test_a_small_gap_that_nothing_explains_is_told_beside_a_large_one_that_is_named(share: float) -> None:
    """The rotor answers a few thousandths more at one line and less at the next, where amplifiers lag by a sample."""
    datasheet, truth = known_datasheet(seed=35)
    rig = with_effects(true_rig(truth), {"loop_delay": {"delay_s": 1e-4}})
    measured = experiment(rig)
    rotor = [
        1 + share * np.random.default_rng(0).standard_normal(len(np.unique(s.frequency_hz))) for s in measured.sweeps
    ]
    sweeps = tuple(answering(rig, s, rotor=r) for s, r in zip(measured.sweeps, rotor, strict=True))
    found = gap_document(diagnose(*one_plane(replace(measured, sweeps=sweeps), datasheet)))
    assert found["verdict"]["effects"] == ["loop_delay"]
    assert any("the plant has a small gap of its own" in note for note in found["notes"]) is (share > 0)


def test_what_nothing_explains_is_blamed_beside_an_explained_part_without_noise() -> None:
    """A controller has hardly any noise, so that its gap is the plainest of all whatever its size."""
    datasheet, truth = known_datasheet(seed=35)
    rig = with_effects(true_rig(truth), {"controller_mismatch": {"gain_change": 0.05}})
    measured = experiment(rig)
    sweeps = tuple(with_stalling_amplifiers(rig, s) for s in measured.sweeps)
    found = gap_document(diagnose(*one_plane(replace(measured, sweeps=sweeps), datasheet)))
    assert found["verdict"]["kind"] == "none_of_these"
    assert found["where"]["path"] == found["where"]["bands_and_channels_of"] == "amplifier"
    assert "wrong in the amplifier no known effect explains" in found["verdict"]["sentence"]
    assert (found["discrepancy"]["path"], found["discrepancy"]["signal"]) == ("amplifier", "i")


def test_what_only_another_sweep_shows_is_told_of_its_part() -> None:
    """On the fitted sweep no part stands out then, and the first would be blamed."""
    datasheet, truth = known_datasheet(seed=36)
    data = observed(experiment(true_rig(truth)), datasheet)
    with Fitter() as fitter:
        found = explain_parts(data, fitter, Progress(None))
    assert locate(found.parts, data.unseen).path == "controller"
    where = locate(found.parts, data.unseen, unexplained="plant")
    assert where.path == where.blamed == "plant"


def with_swings(s: Sweep) -> Sweep:
    """The sweep of a rotor whose answer is some per cent more in one block, less in another, the same in the mean."""
    swing = 0.02 * np.random.default_rng(3).standard_normal(s.Y.shape[:2])
    return replace(s, Y=s.Y * (1 + swing - swing.mean(axis=1, keepdims=True))[:, :, None, None])


def test_an_answer_that_swings_is_no_clean_rig_though_every_mean_is_right() -> None:
    datasheet, truth = known_datasheet(seed=35)
    measured = experiment(true_rig(truth))
    found = gap_document(diagnose(replace(measured, sweeps=tuple(map(with_swings, measured.sweeps))), datasheet))
    assert found["gap"]["before"] < 0.01
    assert found["verdict"]["kind"] == "none_of_these"
    assert found["where"]["path"] == "plant"
    assert "swings from block to block" in found["verdict"]["sentence"]
