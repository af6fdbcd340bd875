"""What is not known of the current that drives the plant is no effect of the plant."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.gap.diagnose import diagnose
from service.gap.fitting.plant_input import LawError, driven_by_current
from service.gap.fitting.predict import displacement
from service.gap.measured.observation import Observation, observe
from sim.rig import Rig
from sim.twin import axis_current_per_control, linear_model, with_effects
from tests.support.synthetic import experiment, known_datasheet, lines, noisy_currents, sweep, true_rig

PLAIN = true_rig(known_datasheet()[1])
SLOWER = {"amplifier_bandwidth": {"frequency_change": -0.15}}


def observed(rig: Rig, noise: float = 1.0) -> Observation:
    return observe(sweep(rig, lines(20), 0.15, seed=3, noise=noise), PLAIN)


def uncertainty_added(share: float, found: Rig) -> np.ndarray:
    """In the displacement at each point and channel, m."""
    o = observed(PLAIN)
    f = o.fundamental
    after = LawError(PLAIN, found, share).on(o)
    assert after.U is o.U, "only the uncertainty changes"
    return np.asarray(np.sqrt(after.sd_y[:, f] ** 2 - o.sd_y[:, f] ** 2))


def test_what_effects_of_the_amplifiers_leave_is_as_uncertain_as_what_they_change() -> None:
    found = with_effects(PLAIN, SLOWER)
    one = uncertainty_added(1.0, found)
    np.testing.assert_allclose(uncertainty_added(0.01, found), 0.1 * one, rtol=1e-6)
    assert np.all(uncertainty_added(1.0, PLAIN) == 0.0)
    o = observed(PLAIN)
    changed = np.abs(displacement(found, o) - displacement(PLAIN, o))
    own = np.arange(len(o.line)), o.axis
    away = ~np.isin(o.points_hz, o.points_hz[np.abs(o.points_hz / 494 - 1) < 0.05])
    assert np.median((one[own] / changed[own])[away]) == pytest.approx(1.0, abs=0.3), "mostly by its own current"


@pytest.mark.parametrize(
    "law", [{"frequency_change": 0.4}, {"frequency_change": -0.3}, {"damping_change": 0.5}, {"lag_s": 3e-5}], ids=str
)
def test_a_current_whose_amplifiers_are_unknown_predicts_the_displacement_within_its_uncertainty(
    law: dict[str, float],
) -> None:
    """What the rotor sees between the samples is another share of them than of those that the twin has."""
    amplifiers = with_effects(PLAIN, {"amplifier_bandwidth": law})
    quiet = observed(amplifiers, noise=1e-3)
    f = quiet.fundamental
    driven = driven_by_current(PLAIN, quiet)
    true = displacement(amplifiers, quiet)
    error = np.abs(displacement(PLAIN, driven) - true)
    fast = quiet.points_hz > 600.0
    assert np.max((error / quiet.sd_y[:, f])[fast]) > 3.0, "beyond noise"
    assert np.max(error / driven.sd_y[:, f]) < 1.0


def of_another_law(measured: Experiment, share: float) -> Experiment:
    """Currents, and with them displacements, that miss those of slower amplifiers by a share of what these change."""
    plain, slower = PLAIN, with_effects(PLAIN, SLOWER)

    def missed(frequency_hz: np.ndarray) -> np.ndarray:
        changed = axis_current_per_control(slower, frequency_hz) / axis_current_per_control(plain, frequency_hz) - 1
        bend = 1 / (1 + (np.log2(frequency_hz / 300.0) / 0.3) ** 2)[:, None]  # no law of the amplifiers follows it
        return np.asarray(1 + share * bend * changed)

    sweeps = []
    for s in measured.sweeps:
        factor, f = missed(s.frequency_hz)[:, None, :], s.harmonics.index(1)
        R, I, Y = s.R.copy(), s.I.copy(), s.Y.copy()
        model = linear_model(slower, s.frequency_hz)
        added = (factor - 1) * I[:, :, f]
        moved = (model.y_per_i[:, None] @ added[..., None])[..., 0]
        I[:, :, f] += added
        Y[:, :, f] += moved
        R[:, :, f] += model.controllers[:, None] * moved  # so that u stays as it was
        sweeps.append(replace(s, R=R, I=I, Y=Y))
    return replace(measured, sweeps=tuple(sweeps))


@pytest.mark.slow
def test_amplifiers_of_another_law_are_no_effect_of_the_plant_beside_them() -> None:
    """The displacement shows what the noise of their currents hides: a resonance was named beside them, with 99 %."""
    datasheet, truth = known_datasheet(seed=41)
    measured = of_another_law(experiment(with_effects(true_rig(truth), SLOWER), seed=7, noise=0.1), 0.05)
    d = diagnose(noisy_currents(measured, 5e-4), datasheet)
    assert d.verdict.effects == ("amplifier_bandwidth",)
