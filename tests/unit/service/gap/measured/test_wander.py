"""A mean displacement that wanders by chance counts as uncertain; one that follows a law does not."""

from dataclasses import replace

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.gap.measured.observation import observe
from sim.twin import rig_from_datasheet
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig
from tests.support.two_axes import one_plane

SHEET, TRUTH = known_datasheet(seed=3)
RIG = rig_from_datasheet(SHEET)
MEASURED = sweep(true_rig(TRUTH), lines(), 0.15, seed=1)
PLAIN_SD = observe(MEASURED, RIG).sd_y[:, 0]


def pushed(by: np.ndarray) -> Sweep:
    """The sweep with static displacements ``by`` (P, n), m."""
    Y = MEASURED.Y.copy()
    Y[:, :, 0] += by[:, None]
    return replace(MEASURED, Y=Y)


def test_flux_that_stays_by_chance_makes_the_mean_uncertain() -> None:
    size = 20 * np.median(PLAIN_SD)
    by = np.where(np.random.default_rng(1).uniform(size=PLAIN_SD.shape) < 0.5, -size, size)
    found = observe(pushed(by), RIG)
    assert 0.5 * size < np.median(found.sd_y[:, 0]) < 3 * size
    others = [k for k, h in enumerate(found.harmonics) if h]
    np.testing.assert_allclose(found.sd_y[:, others], observe(MEASURED, RIG).sd_y[:, others], rtol=1e-9)


def test_what_a_swing_has_left_behind_makes_the_mean_of_that_axis_uncertain_for_good() -> None:
    """An axis that has been shaken stays 100 nm aside while the other plane is, and no deterministic force does so."""
    step, by = 1e-7, np.zeros_like(PLAIN_SD)
    by[MEASURED.axis >= 2, 1] = step
    found, plain = observe(pushed(by), RIG).sd_y[:, 0], PLAIN_SD
    assert found[:, 1].min() > 0.7 * step
    np.testing.assert_allclose(found[:, 2:], plain[:, 2:], rtol=0.5)


def test_a_static_force_that_grows_with_the_square_of_the_current_is_no_chance() -> None:
    assert MEASURED.I is not None
    current = np.abs(MEASURED.I[:, :, 1].mean(axis=1))
    found = observe(pushed(100 * np.median(PLAIN_SD) * (current / current.max()) ** 2), RIG)
    assert np.median(found.sd_y[:, 0] / PLAIN_SD) < 1.5


def test_a_rig_with_one_plane_is_told_of_it_too() -> None:
    size = 20 * np.median(PLAIN_SD)
    by = np.where(np.random.default_rng(1).uniform(size=PLAIN_SD.shape) < 0.5, -size, size)
    measured, sheet = one_plane(Experiment(RIG.name, RIG.axes, (pushed(by),)), SHEET)
    found = observe(measured.sweeps[0], rig_from_datasheet(sheet))
    assert 0.5 * size < np.median(found.sd_y[:, 0]) < 3 * size
