"""Hum in blocks that follow one another: heard by its phase, taken off, and never found in noise."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.interference import heard_at_speed, interference, told_apart
from service.gap.measured.coherent import (
    beside_hum,
    coherence,
    hum_frequency,
    hum_power,
    left_in_mean,
    slow_leaks,
    without_hum,
)
from service.gap.measured.scatter import mean_scatter
from service.gap.measured.settling import UNSETTLED, drifting
from service.gap.measured.sweeps import timed
from sim.reference import reference_rig

BLOCKS, AXES, HARMONICS, RATE_HZ = 6, 4, (0, 1, 2, 3), 10_000.0
NOISE_M = 1e-9


def played(hum_m: float, hum_hz: float, seed: int, block_s: float = 0.05) -> tuple[Sweep, Sweep]:
    """A sweep of samples with a response and noise, demodulated block by block: (with a hum on y, without)."""
    rng = np.random.default_rng(seed)
    frequency = np.repeat(np.geomspace(12, 300, 40), 2)
    periods = np.ceil(frequency * block_s)
    samples = np.round(periods * RATE_HZ / frequency).astype(int)
    frequency = periods * RATE_HZ / samples
    clean = np.zeros((len(frequency), BLOCKS, len(HARMONICS), AXES), dtype=complex)
    hum = np.zeros_like(clean)
    for p, (k, n) in enumerate(zip(periods, samples, strict=True)):
        t = np.arange(BLOCKS * n)
        noise = NOISE_M * np.sqrt(n / 2) * rng.standard_normal((len(t), AXES))
        tone = 1e-6 * np.cos(2 * np.pi * k * t / n + rng.uniform(0, 6))[:, None] * rng.uniform(0.3, 1, AXES)
        added = hum_m * np.cos(2 * np.pi * hum_hz * t / RATE_HZ + rng.uniform(0, 6))[:, None] * np.ones(AXES)
        for j, h in enumerate(HARMONICS):
            basis = np.exp(-2j * np.pi * h * k * t / n) * (2 if h else 1) / n
            clean[p, :, j] = (basis[:, None] * (tone + noise)).reshape(BLOCKS, n, AXES).sum(axis=1)
            hum[p, :, j] = (basis[:, None] * added).reshape(BLOCKS, n, AXES).sum(axis=1)
    zero = np.zeros_like(clean)
    without = Sweep(
        "stepped-sine", frequency, np.tile([0, 1], 40), np.ones(len(frequency)), HARMONICS, zero, zero, zero, clean,
        sample_rate_hz=RATE_HZ, block_samples=samples,
    )  # fmt: skip
    return replace(without, Y=clean + hum), without


@pytest.mark.parametrize("hum_hz", [15.1, 27.3, 50.0, 60.0, 120.0])
def test_a_hum_is_heard_where_it_is_and_as_loud_as_it_is(hum_hz: float) -> None:
    loud, _ = played(5e-9, hum_hz, seed=1)
    share, deviate = coherence(loud, loud.Y, hum_hz)
    assert share > 0.5
    assert deviate > 8
    heard = np.sqrt(np.mean(hum_power(loud, loud.Y, hum_hz)))
    assert heard == pytest.approx(5e-9, rel=0.15)


@pytest.mark.parametrize(("hum_m", "block_s", "at_most_hz"), [(2e-7, 0.05, 0.01), (5e-9, 0.05, 0.1), (2e-8, 0.2, 0.05)])
def test_the_frequency_of_a_hum_is_measured_and_so_is_how_well(hum_m: float, block_s: float, at_most_hz: float) -> None:
    """Of a mains that is off its nominal frequency, by more than the deviation that is stated."""
    deviates = []
    for seed, hum_hz in enumerate(np.linspace(49.6, 50.4, 9)):
        loud, _ = played(hum_m, hum_hz, seed, block_s)
        found_hz, deviation_hz = hum_frequency(loud, loud.Y, 50.0)
        assert deviation_hz < at_most_hz
        deviates.append((found_hz - hum_hz) / deviation_hz)
    assert np.abs(deviates).max() < 3.0


def test_lines_of_one_block_length_leave_the_frequency_of_a_hum_open() -> None:
    """It turns forward as fast as another one backward."""
    loud, _ = played(2e-8, 49.7, seed=3, block_s=1.0)
    found_hz, deviation_hz = hum_frequency(loud, loud.Y, 50.0)
    assert abs(found_hz - 49.7) < 2 * deviation_hz
    assert deviation_hz > 0.1


@pytest.mark.parametrize("hum_hz", [49.9, 50.0, 60.0, 60.1])
@pytest.mark.parametrize("without", [(0, 0), (44, 53), (54, 66)], ids=["all lines", "none near 50", "none near 60"])
def test_a_hum_of_blocks_whose_length_is_not_known_is_named_by_where_the_scatter_is_highest(
    hum_hz: float, without: tuple[float, float]
) -> None:
    """Not by where there are most lines: 50 and 60 Hz leak into one another's neighbourhood."""
    loud, _ = played(2e-7, hum_hz, seed=1)
    sweep = replace(loud, I=None, block_samples=None)
    low, high = without
    heard = interference(sweep.select((sweep.frequency_hz < low) | (sweep.frequency_hz > high)), reference_rig())
    assert [(s.effect, s.frequency_hz) for s in heard] == [("mains_interference", 10 * round(hum_hz / 10))]
    assert heard[0].frequency_std_hz > abs(heard[0].frequency_hz - hum_hz)


def test_a_hum_between_the_lines_is_as_loud_as_it_is_too() -> None:
    """No line comes within half a resolution of it, as where a rotor's speed lies between them."""
    loud, _ = played(5e-9, 50.0, seed=1)
    distance = np.abs(loud.frequency_hz[:, None] * np.array(HARMONICS[1:]) - 50.0).min(axis=1)
    away = distance * loud.block_samples / RATE_HZ > 0.55
    apart = loud.select(away)
    heard = hum_power(apart, apart.Y, 50.0)
    assert len(heard)
    assert np.sqrt(np.mean(heard)) == pytest.approx(5e-9, rel=0.25)
    far = loud.select(distance > 40.0)
    assert len(hum_power(far, far.Y, 50.0)) == 0


def test_noise_alone_is_no_hum() -> None:
    deviates = [
        coherence(quiet, quiet.Y, f)[1] for seed in range(8) for _, quiet in [played(0.0, 50.0, seed)]
        for f in (15.1, 50.0, 60.0, 100.0, 150.0)
    ]  # fmt: skip
    assert max(deviates) < 6
    assert abs(np.mean(deviates)) < 1, "the share of noise is known"


@pytest.mark.parametrize("hum_hz", [15.1, 50.0, 110.0])
def test_what_it_leaves_in_a_mean_is_taken_off_or_foretold(hum_hz: float) -> None:
    """A hum of a thousand times the noise leaks into every point."""
    loud, quiet = played(1e-6, hum_hz, seed=2)
    before, left = (np.abs(s.Y.mean(axis=1) - quiet.Y.mean(axis=1)) for s in (loud, without_hum(loud, hum_hz)))
    foretold = left_in_mean(loud, loud.Y, [hum_hz])
    taken = foretold == 0
    assert taken.mean() > 0.3
    assert np.mean(left[taken] ** 2) < NOISE_M**2 < 1e-2 * np.mean(before[taken] ** 2)
    assert np.mean(left[~taken] ** 2) == pytest.approx(np.mean(foretold[~taken] ** 2), rel=0.5)
    others = left_in_mean(loud, loud.Y, [50.3, hum_hz])
    assert np.mean(before**2) == pytest.approx(np.mean(others**2), rel=0.7), "one that is not the loudest is foretold"


@pytest.mark.parametrize("hum_hz", [15.1, 50.0, 110.0])
def test_without_it_the_scatter_is_that_of_the_noise(hum_hz: float) -> None:
    loud, quiet = played(1e-7, hum_hz, seed=3)
    turning = np.abs((hum_hz * loud.block_samples / RATE_HZ + 0.5) % 1 - 0.5) > 0.2
    before, after, noise = (np.mean(s.select(turning).Y.var(axis=1)) for s in (loud, without_hum(loud, hum_hz), quiet))
    assert before > 20 * noise
    assert 0.7 * noise < after < 2 * noise


@pytest.mark.parametrize("hum_hz", [15.1, 50.0, 110.0])
def test_beside_it_the_scatter_foretells_how_far_off_responses_are(hum_hz: float) -> None:
    """What is left of the blocks goes together from one to the next as noise does not: no ends cancel in that."""
    loud, _ = played(1e-6, hum_hz, seed=4)
    by = beside_hum(loud, hum_hz)
    told = by.dof < BLOCKS - 1
    assert told.mean() > 0.5
    _, _, of_y = mean_scatter(without_hum(loud, hum_hz), reference_rig(), by)
    true = 2 * NOISE_M**2 * (np.abs(by.weights) ** 2).sum(axis=1)
    assert np.mean(of_y[told, 1:] / true[told, None, None]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("turns_hz", [14.0, 19.2, 42.9, 43.6])
def test_a_loud_hum_is_not_heard_as_another_that_it_only_leaks_to(turns_hz: float) -> None:
    loud, _ = played(3e-6, turns_hz, seed=5)
    heard = interference(replace(loud, speed_rad_s=2 * np.pi * turns_hz), reference_rig())
    assert [(s.effect, s.aliases) for s in heard] == [("runout", ())]


@pytest.mark.parametrize("turns_hz", [50.8, 61.0])
def test_overtones_of_a_rotor_that_turns_at_nearly_the_mains_are_not_its(turns_hz: float) -> None:
    """Twice the speed is nearer to twice the mains than blocks of a fiftieth of a second tell apart."""
    loud, _ = played(1e-6, turns_hz, 5, block_s=0.02)
    for k, seed in ((2, 6), (3, 7)):
        overtone, quiet = played(4e-7, k * turns_hz, seed, block_s=0.02)
        loud = replace(loud, Y=loud.Y + overtone.Y - quiet.Y)
    heard = interference(replace(loud, speed_rad_s=2 * np.pi * turns_hz), reference_rig())
    assert [s.effect for s in heard] == ["runout"]


def test_a_rotor_that_turns_at_the_mains_frequency_leaves_both_open() -> None:
    loud, _ = played(1e-6, 50.0, seed=8)
    heard = interference(replace(loud, speed_rad_s=2 * np.pi * 50.0), reference_rig())
    assert [{s.effect, *s.aliases} for s in heard] == [{"mains_interference", "runout"}]


@pytest.mark.parametrize(
    ("hums_at", "speed_hz", "told"),
    [
        (37.0, 37.0, ("runout", 50.0, ())),
        (50.0, 37.0, ("mains_interference", 50.0, ())),
        (50.0, 0.0, ("mains_interference", 50.0, ())),
        (50.0, 51.0, None),
        (80.0, 37.0, None),
    ],
    ids=["moves with the rotor", "stays", "stays at standstill", "speeds alike", "is gone"],
)
def test_another_speed_tells_what_turns_from_what_stays(
    hums_at: float, speed_hz: float, told: tuple[str, float, tuple[str, ...]] | None
) -> None:
    main, other = (played(1e-6, hz, seed)[0] for hz, seed in ((50.0, 8), (hums_at, 9)))
    main, other = replace(main, speed_rad_s=2 * np.pi * 50.0), replace(other, speed_rad_s=2 * np.pi * speed_hz)
    rig = reference_rig()
    heard = tuple(interference(main, rig))
    (s,) = named = told_apart(heard, main, other, rig)
    assert heard[0].aliases
    if told is None:
        assert named == heard
    else:
        assert (s.effect, s.frequency_hz, s.aliases) == told
        assert s.parameters["amplitude_m"] == pytest.approx(1e-6, rel=0.2)
    assert told_apart(heard, main, replace(other, block_samples=None), rig) == heard


@pytest.mark.parametrize("turns_hz", [43.0, 50.0])
def test_runout_of_a_rotor_that_turned_in_the_other_sweep_alone_is_heard_there(turns_hz: float) -> None:
    """Also at the mains' frequency: at standstill nothing is heard of that."""
    (_, main), (other, quiet), rig = played(0.0, turns_hz, 1), played(2e-7, turns_hz, 2), reference_rig()
    turning = {"speed_rad_s": 2 * np.pi * turns_hz}
    (heard,) = heard_at_speed((), main, replace(other, **turning), rig)
    assert (heard.effect, heard.aliases) == ("runout", ())
    assert heard.frequency_hz == pytest.approx(turns_hz)
    assert heard.parameters["amplitude_m"] == pytest.approx(2e-7, rel=0.2)
    assert heard_at_speed((), main, replace(quiet, **turning), rig) == ()


def test_a_mains_that_is_heard_at_standstill_is_no_runout_of_a_rotor_that_turns_as_fast() -> None:
    (main, _), (other, _), rig = played(2e-7, 50.0, 1), played(2e-7, 50.0, 2), reference_rig()
    sources = tuple(interference(main, rig))
    assert [s.effect for s in sources] == ["mains_interference"]
    assert heard_at_speed(sources, main, replace(other, speed_rad_s=100 * np.pi), rig) == sources


def test_a_faint_hum_is_heard_beside_a_loud_one() -> None:
    loud, _ = played(3e-6, 17.3, seed=6)
    faint, quiet = played(2e-8, 50.0, seed=7)
    both = replace(loud, Y=loud.Y + faint.Y - quiet.Y, speed_rad_s=2 * np.pi * 17.3)
    heard = interference(both, reference_rig())
    assert [(s.effect, s.frequency_hz) for s in heard] == [("runout", 17.3), ("mains_interference", 50.0)]


def test_a_file_that_does_not_tell_its_blocks_is_heard_as_well_where_its_lines_tell_them() -> None:
    loud, _ = played(5e-9, 50.0, seed=1)
    told = timed(replace(loud, block_samples=None))
    assert told.block_samples is not None
    assert np.mean(told.block_samples == loud.block_samples) > 0.9
    assert coherence(told, told.Y, 50.0)[1] > 0.8 * coherence(loud, loud.Y, 50.0)[1]
    odd = replace(loud, block_samples=None, frequency_hz=loud.frequency_hz * np.pi / 3)
    assert timed(odd).block_samples is None, "no whole number of samples holds whole periods"


def test_a_hum_that_hardly_turns_from_block_to_block_is_no_drift_and_a_drift_beside_it_is_one() -> None:
    """Of a rotor that turns nearly once a block: its runout looks like a trend in most points."""
    hz = 18.4
    loud, _ = played(3e-7, hz, seed=1)
    decay = 1 + 2 * np.exp(-np.arange(BLOCKS) / 2)
    restless = replace(loud, Y=loud.Y * decay[:, None, None])
    leaks = slow_leaks(loud, loud.U, (hz,)), slow_leaks(loud, loud.Y, (hz,))
    assert drifting(loud)[0].mean() > 0.2
    assert drifting(loud, leaks)[0].mean() < 0.05
    assert drifting(restless, leaks)[0].mean() > UNSETTLED
