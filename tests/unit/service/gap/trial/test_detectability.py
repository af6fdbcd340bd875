"""The yardstick: nothing for nothing, more for more, and little for what a datasheet's tolerance covers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.gap.trial.detectability import Replayed, detectability, quiet, replay, settle_s
from sim.datasheet import Tolerance
from sim.effects import CATALOGUE
from sim.reference import reference_rig
from sim.rig import Rig
from sim.stepping import Simulation

pytestmark = pytest.mark.slow

RIG = reference_rig()
BLOCKS = 6
AMPLITUDE_A = 0.05
TOLERANCE = Tolerance(mode_frequency=0.005)


def tones(lines_hz: Sequence[float] = tuple(np.geomspace(15, 800, 10))) -> Sweep:
    """What is asked of the rig; no amplitudes yet."""
    frequency = np.repeat(lines_hz, 4)
    empty = np.zeros((len(frequency), BLOCKS, 4, 4), dtype=complex)
    return Sweep(
        "stepped-sine",
        frequency,
        np.tile(np.arange(4), len(lines_hz)),
        np.full(len(frequency), AMPLITUDE_A),
        (0, 1, 2, 3),
        *(empty.copy() for _ in range(4)),
    )


def played(rig: Rig, sweep: Sweep) -> Replayed:
    return replay(Simulation(quiet(rig)), sweep, settle_s([RIG], sweep))


@pytest.fixture(scope="module")
def plain() -> Replayed:
    return played(RIG, tones())


@pytest.fixture(scope="module")
def measured(plain: Replayed) -> Sweep:
    return noised(plain, tones())


def noised(plain: Replayed, sweep: Sweep) -> Sweep:
    """The plain rig's amplitudes with noise of every block; the controller passes its sensors' noise on."""
    rng = np.random.default_rng(1)

    def noisy(X: np.ndarray, sd: float) -> np.ndarray:
        shape = (len(X), BLOCKS, *X.shape[1:])
        return X[:, None] + sd * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    return replace(sweep, R=noisy(plain.R, 0.0), U=noisy(plain.U, 1e-5), I=noisy(plain.I, 1e-4), Y=noisy(plain.Y, 1e-9))


def shown(rig: Rig, plain: Replayed, measured: Sweep) -> float:
    return against(played(rig, measured), plain, measured)


def against(with_it: Replayed, plain: Replayed, measured: Sweep) -> float:
    def replayed(rig: Rig) -> list[Replayed]:
        return [plain if rig is RIG else played(rig, measured)]

    return detectability(RIG, TOLERANCE, [(measured, with_it)], replayed)


def test_a_replay_answers_as_the_linear_model_does(plain: Replayed) -> None:
    from sim.twin import linear_model

    sweep = tones()
    model = linear_model(RIG, sweep.frequency_hz)
    expected = (model.y_per_u @ model.u_per_r)[np.arange(40), :, sweep.axis] * AMPLITUDE_A
    error = np.linalg.norm(plain.Y[:, 1] - expected) / np.linalg.norm(expected)
    assert error < 0.02


def test_a_rig_without_a_secret_shows_nothing(plain: Replayed, measured: Sweep) -> None:
    assert shown(RIG, plain, measured) == pytest.approx(0.0, abs=1e-6)


def test_a_stronger_effect_shows_more_in_proportion(plain: Replayed, measured: Sweep) -> None:
    weak, strong = (shown(CATALOGUE["loop_delay"].on(RIG, delay_s=delay), plain, measured) for delay in (5e-6, 20e-6))
    assert weak > 10
    assert strong / weak == pytest.approx(4, rel=0.25)


def test_what_a_datasheet_may_be_wrong_in_hardly_shows(plain: Replayed, measured: Sweep) -> None:
    stiffer = replace(RIG, magnets=replace(RIG.magnets, ki=RIG.magnets.ki * np.array([1.03, 1, 1, 1])))
    within = shown(stiffer, plain, measured)
    change = shown(CATALOGUE["loop_delay"].on(RIG, delay_s=20e-6), plain, measured)
    assert within < 10 < change / 4


def test_harmonics_show_what_the_fundamental_does_not(plain: Replayed, measured: Sweep) -> None:
    third = np.arange(4)[:, None] == 3
    distorted = replace(plain, Y=plain.Y + np.where(third, 2e-9, 0.0))
    assert against(distorted, plain, measured) > 10


def test_a_damping_within_its_tolerance_costs_no_more_than_that_where_the_mode_rings_for_long() -> None:
    modes = [list(plane) for plane in RIG.rotor.modes]
    modes[0][0] = replace(modes[0][0], damping_ratio=0.4 * modes[0][0].damping_ratio)
    rig = replace(RIG, rotor=replace(RIG.rotor, modes=tuple(map(tuple, modes))))
    at_hz = RIG.rotor.modes[0][0].natural_frequency_rad_s / (2 * np.pi)
    sweep = tones([60.0, at_hz + 5, at_hz + 7.1, at_hz + 9])  # the controller moves its peak up by 7 Hz
    wait = settle_s([RIG, rig], sweep)

    def replayed(rig: Rig) -> list[Replayed]:
        return [replay(Simulation(quiet(rig)), sweep, wait)]

    (plain,), (with_it,) = replayed(RIG), replayed(rig)
    found = detectability(RIG, TOLERANCE, [(noised(plain, sweep), with_it)], replayed)
    assert found < 1.2 * np.log(1 / 0.4) / TOLERANCE.mode_damping
