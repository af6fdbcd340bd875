"""Points in which something rang, after a start or kept up by noise: it is taken out, and nothing where nothing did."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.identification.fit import identify
from service.identification.joint.residuals import noise_of, predicted_blocks, residual_blocks
from service.identification.loop.closed_loop import closed_loop_poles
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.plane.model import PlaneModel
from service.identification.plane_fit import FittedPlane, fit_plane
from service.identification.ringing.leakage import leakage
from service.identification.ringing.pole import Ringing, RingingPole, as_it_ran, slow_poles
from service.identification.ringing.transient import Transient, settled
from service.identification.ringing.transient_size import Source, Taken
from tests.support.planes import synthetic_experiment, synthetic_sweep
from tests.support.ringing import AXES, BLOCKS, CONTROLLER, HZ, RATE, SHEET, TRUTH, late, run, sheet

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def hasty() -> Sweep:
    return run(0.25)


def assert_the_truth(plane) -> None:
    for mode, w, zeta in zip(plane.modes, TRUTH.natural_frequencies, TRUTH.damping_ratios, strict=True):
        assert mode.damping_ratio.value == pytest.approx(zeta, rel=0.02)
        assert abs(mode.damping_ratio.value - zeta) < 4 * mode.damping_ratio.std
        assert mode.natural_frequency_rad_s.value == pytest.approx(w, rel=5e-4)
    found = plane.stiffness
    for key, value in zip(("ksA", "ksB", "kiA", "kiB"), [*TRUTH.ks, *TRUTH.ki], strict=True):
        assert found[key].value == pytest.approx(value, rel=2e-3)


def untold(sweep: Sweep) -> Sweep:
    """Neither by the file nor by its lines: off a whole number of samples by what no response notices."""
    return replace(sweep, block_samples=None, frequency_hz=sweep.frequency_hz * (1 + 1e-6))


@pytest.mark.parametrize("by", ["file", "lines", "nothing"])
def test_damping_is_right_though_the_tones_were_recorded_before_they_settled(hasty: Sweep, by: str) -> None:
    """The loop damps mode 1 with 5.6 1/s: after 0.25 s a quarter of what the start made rings on.

    The length of the blocks is told by the file, by lines that are whole periods in whole samples, or by nothing.
    """
    sweep = {"file": hasty, "lines": replace(hasty, block_samples=None), "nothing": untold(hasty)}[by]
    plane = identify(synthetic_experiment(sweep, axes=AXES), sheet()).planes["x"]
    assert_the_truth(plane)
    assert plane.adequate
    assert any("500.5 Hz mode of the closed loop still rang" in w for w in plane.warnings)


def test_without_it_the_damping_would_be_off(hasty: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    """That the test above tests something."""
    monkeypatch.setattr("service.identification.plane_fit.settled", lambda data, *_: (data, ()))
    plane = identify(synthetic_experiment(hasty, axes=AXES), sheet()).planes["x"]
    assert abs(plane.modes[0].damping_ratio.value / TRUTH.damping_ratios[0] - 1) > 0.03


def test_what_dies_within_the_first_block_is_taken_out_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop damps mode 2 with 60 1/s: in blocks of 0.05 s its start is in the first one alone."""
    experiment = synthetic_experiment(run(0.05), axes=AXES)
    found = identify(experiment, sheet()).planes["x"]
    monkeypatch.setattr("service.identification.ringing.transient.GONE", 0.3)
    left = identify(experiment, sheet()).planes["x"]
    assert_the_truth(found)
    now, before = (plane.modes[1].damping_ratio.std for plane in (found, left))
    assert now < 0.7 * before
    assert not any("Hz mode" in w and "500" not in w for w in found.warnings)  # nobody need do anything about it


def test_what_lasts_is_not_taken_for_what_dies_within_the_first_block() -> None:
    """Where both are large: the suspension at 15 Hz dies in a twentieth of a second, mode 1 rings on for half one."""
    plane = identify(synthetic_experiment(run(0.05, seed=1), axes=AXES), sheet()).planes["x"]
    assert_the_truth(plane)
    assert any("500.5 Hz mode of the closed loop still rang" in w for w in plane.warnings)


@pytest.fixture(scope="module")
def patient() -> tuple[Sweep, FittedPlane]:
    """Points that had settled, and what is found in them."""
    sweep = run(2.0, seed=1)
    return sweep, fit_plane(sweep, None, None, AXES, "x", sheet())


def test_of_settled_points_nobody_is_told_anything(patient: tuple[Sweep, FittedPlane]) -> None:
    assert patient[1].transients == ()


def test_starts_that_may_be_there_cost_settled_points_no_stiffness(
    patient: tuple[Sweep, FittedPlane], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mode's start may be there where noise keeps the loop ringing; the suspension's must show beyond doubt."""
    sweep, plane = patient
    found = plane.result(sheet()).stiffness["ksB"].std_from_data
    monkeypatch.setattr("service.identification.ringing.transient._rings_on", lambda *_: False)
    otherwise = fit_plane(sweep, None, None, AXES, "x", sheet()).result(sheet()).stiffness["ksB"].std_from_data
    assert found is not None
    assert otherwise is not None
    assert found < 1.01 * otherwise


def test_what_is_left_of_a_start_from_rest_is_as_large_as_predicted() -> None:
    """At either bearing: the excitation, the loop's residue there, and a decay over the time that it was given."""
    sweep = run(0.4, noisy=False)
    points = plane_points(sweep, AXES, "x")
    e = residual_blocks(points, *predicted_blocks(TRUTH, points, None))
    pole = min(slow_poles(TRUTH, CONTROLLER, 0.05, 0.3), key=lambda p: abs(p.imag - 3145))
    left = RingingPole.of(points, TRUTH, CONTROLLER, pole).ringing(sweep.block_samples[points.index] / RATE).left
    near = abs(points.omega / pole.imag - 1) < 0.015
    assert set(points.axis[near]) == {0, 1}
    shares = np.linalg.norm(e[near, :, 2:], axis=(1, 2)) / np.linalg.norm(left[near, :, 2:], axis=(1, 2))
    assert shares == pytest.approx(np.exp(pole.real * 0.4), rel=0.03)


def test_starts_that_blocks_only_hint_at_are_as_large_as_they_are_expected_to_be() -> None:
    """Of any size between nothing and one from rest, also where the likeliest is that there is none."""
    points, blocks, runs = 6, 6, 400
    rng = np.random.default_rng(0)
    powers = np.broadcast_to(0.8 ** np.arange(blocks), (points, blocks)).astype(complex)
    ringing = Ringing(np.full((points, 1), 1.5, complex), np.ones(points, complex), powers)
    white, axis = np.ones((points, 1, 1), complex), np.zeros(points, dtype=np.int64)

    def normal(*shape: int) -> np.ndarray:
        return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)

    sizes, expected, unseen = rng.uniform(0, 1, runs), np.zeros(runs), np.zeros(runs, dtype=bool)
    for k, size in enumerate(sizes):
        started = size * normal(points)[:, None, None] * ringing.left
        taken = Taken(started + normal(points, blocks, 1), white)
        expected[k], unseen[k] = taken.allowed(ringing), taken.started(ringing, axis)[0] == 0
    assert 50 < unseen.sum() < 350
    for some in (unseen, ~unseen):
        error = expected[some] - sizes[some] ** 2
        assert abs(error.mean()) < 4 * error.std() / np.sqrt(some.sum())
        assert error.std() < np.std(sizes**2)


def test_points_in_which_nothing_rang_are_left_as_they_are() -> None:
    """Noise that does not go through the loop, as of a response that was measured otherwise."""
    n = np.round(np.maximum(1, np.round(HZ * 0.05)) * RATE / HZ).astype(int)
    sweep = replace(synthetic_sweep({"x": TRUTH}, AXES, CONTROLLER, HZ, 0.12), block_samples=np.tile(n, 2))
    found = fit_plane(sweep, None, None, AXES, "x", sheet())
    assert found.transients == ()
    assert np.array_equal(found.data.plant.Y, plane_points(sweep, AXES, "x").Y)
    assert found.data.plant.unsettled is None


def test_damping_is_right_where_the_loop_hardly_damps_the_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """30 us of delay, which the controller was not made for, leave 1.1 1/s: noise alone keeps the mode ringing."""
    truth = late(30e-6)
    experiment = synthetic_experiment(run(0.3, seed=3, truth=truth), axes=AXES)
    mode = identify(experiment, sheet()).planes["x"].modes[0].damping_ratio
    assert mode.value == pytest.approx(truth.damping_ratios[0], rel=0.06)
    assert abs(mode.value - truth.damping_ratios[0]) < 4 * mode.std
    monkeypatch.setattr("service.identification.plane_fit.settled", lambda data, *_: (data, ()))
    without = identify(experiment, sheet()).planes["x"].modes[0].damping_ratio
    assert abs(without.value / truth.damping_ratios[0] - 1) > 0.3


@pytest.fixture(scope="module")
def kept_ringing() -> tuple[PlaneModel, Sweep]:
    """Of the start 4 % are left, and noise keeps up ten times as much."""
    truth = late(30e-6)
    return truth, run(3.0, truth=truth)


def test_what_is_left_of_a_start_is_in_the_deviation_where_noise_keeps_up_more(
    kept_ringing: tuple[PlaneModel, Sweep],
) -> None:
    """Also where 2 % are left, and the blocks are likeliest without."""
    half_way = late(20e-6)
    for truth, sweep in (kept_ringing, (half_way, run(1.5, seed=1, truth=half_way))):
        mode = identify(synthetic_experiment(sweep, axes=AXES), sheet()).planes["x"].modes[0].damping_ratio
        assert abs(mode.value - truth.damping_ratios[0]) < 2 * mode.std
        assert mode.std < 0.008 * mode.value


def test_what_noise_leaves_in_the_blocks_is_as_large_as_predicted(kept_ringing: tuple[PlaneModel, Sweep]) -> None:
    """Near the mode a hundred times the noise itself; in units of both, the blocks' changes scatter by one."""
    truth, sweep = kept_ringing
    points = plane_points(sweep, AXES, "x")
    seconds = sweep.block_samples[points.index] / RATE
    i, y = predicted_blocks(truth, points, None)
    e = residual_blocks(points, i, y)
    plain = 4 / (seconds * RATE)[:, None] * np.array([2e-3, 2e-3, 20e-9, 20e-9]) ** 2
    white = np.einsum("pc,cd->pcd", plain**-0.5, np.eye(4))
    kept_up = leakage(points, truth, CONTROLLER, seconds, np.full(2, 20e-9))
    near = abs(points.omega / truth.natural_frequencies[0] - 1) < 0.01
    for rows in (near, ~near):
        taken = Taken(e[rows], white[rows], (Source(kept_up[rows], np.ones(rows.sum())),))
        n = 4 * (BLOCKS - 1) * rows.sum()
        assert squares(taken) / n == pytest.approx(1.0, abs=5 / np.sqrt(n))
        assert (squares(replace(taken, sources=())) / n > 20) == (rows is near)


def squares(taken: Taken) -> float:
    """Of the blocks' changes, in units of all that is known to move them."""
    return replace(taken, measured=np.zeros_like(taken.measured)).likelihood - taken.likelihood


def test_a_loop_that_grows_in_the_model_is_taken_as_it_ran() -> None:
    theta = TRUTH.theta.copy()
    theta[TRUTH.layout.mode(0).start + 1] = -20.0
    grows = TRUTH.at(theta)
    assert np.abs(closed_loop_poles(grows, CONTROLLER)).max() > 1
    tamed = as_it_ran(grows, CONTROLLER, 3.0)
    assert np.log(np.abs(closed_loop_poles(tamed, CONTROLLER)).max()) * RATE <= -3.0
    assert tamed.damping_ratios[1] == grows.damping_ratios[1]
    assert as_it_ran(TRUTH, CONTROLLER, 3.0) is TRUTH


def test_a_loop_that_only_an_impossible_mode_would_hold_is_left_as_it_is() -> None:
    """A fit that failed has a mode at a few hundredths of a hertz that grows slowly, and is told of for what it is.

    To die away as fast as the blocks saw it would take a damping ratio of 26; what went on with that ended in a
    traceback.
    """
    theta = TRUTH.theta.copy()
    theta[TRUTH.layout.mode(0)] = [0.232, -0.046, 0.001, 0.005, -0.003, -0.004]
    grows = TRUTH.at(theta)
    assert grows.is_physical
    assert np.abs(closed_loop_poles(grows, CONTROLLER)).max() > 1
    assert as_it_ran(grows, CONTROLLER, 3.0) is grows


def test_what_is_not_known_of_a_transient_is_in_the_noise(hasty: Sweep) -> None:
    """At the peak a transient looks most like the settled motion: such points count for less, others as before."""
    points = plane_points(hasty, AXES, "x")
    block_s = hasty.block_samples[points.index] / RATE
    data, found = settled(Data(points), TRUTH, TRUTH.layout.free(), CONTROLLER, block_s)
    assert abs(found[0].pole.imag) == pytest.approx(3144.9, abs=2)
    left = data.plant.unsettled
    known = replace(data.plant, unsettled=replace(left, mean=np.zeros_like(left.mean)))
    plain = noise_of(TRUTH, known, None).sigma[:, -2:]
    whole = noise_of(TRUTH, data.plant, None).sigma[:, -2:]
    near = abs(points.omega - 3144.9) < 20
    far = points.omega > 4700  # below, the suspension's own motion is not known either
    assert np.all(whole >= plain)
    assert np.max(whole[near] / plain[near]) > 1.5
    assert np.median(whole[far] / plain[far]) < 1.02


def test_a_plane_is_asked_again_where_the_other_one_rang(hasty: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points of a campaign are recorded alike: what one plane tells of their blocks holds for all."""
    asked = []

    def recorded(data: Data, *rest: object) -> tuple[Data, tuple[Transient, ...]]:
        asked.append((data.plant.plane, *rest[3:]))
        found = settled(data, *rest) if data.plant.plane == "x" else (data, ())
        return found

    monkeypatch.setattr("service.identification.plane_fit.settled", recorded)
    both = replace(
        hasty,
        **{s: np.concatenate([_beside(getattr(hasty, s)), _beside(getattr(hasty, s))[..., ::-1]]) for s in "RUIY"},
        frequency_hz=np.tile(hasty.frequency_hz, 2),
        amplitude_a=np.tile(hasty.amplitude_a, 2),
        axis=np.concatenate([hasty.axis, 3 - hasty.axis]),
    )
    result = identify(synthetic_experiment(untold(both), axes=SHEET.axes), SHEET)
    # what then does not agree is looked for in other values of the geometry
    assert [plane for plane, *_ in asked[:3]] == ["x", "y", "y"]
    (_, first, early), (_, none, _), (_, length, suspected) = asked[:3]
    assert first is none is None
    assert not early
    assert suspected
    assert length == pytest.approx(0.05, rel=0.05)
    assert any("still rang" in w for w in result.planes["x"].warnings)


def _beside(signal: np.ndarray) -> np.ndarray:
    """Two axes' signals with those of two more that do not move."""
    return np.concatenate([signal, np.zeros_like(signal)], axis=-1)
