"""The exact derivatives of the twin's answer, against differences of it."""

import numpy as np
import pytest

from service.gap.jacobian import answer_and_jacobian
from service.gap.nuisance import nuisance
from service.gap.observation import observe
from service.gap.predict import linear_answer
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

EFFECTS = [
    {},
    {"loop_delay": {"delay_s": 3e-5}, "channel_crosstalk": {"share_ab": 0.03}},
    {"support_resonance": {"frequency_hz": 300.0}, "magnetic_cross_coupling": {"rotation_rad": 0.03}},
    {"eddy_currents": {"time_constant_s": 1e-5, "corner_rad_s": 1e4}, "logging_offset": {"samples": 1.0}},
]


@pytest.mark.parametrize("effects", EFFECTS, ids=lambda e: "+".join(e) or "plain")
def test_every_column_is_the_derivative_of_the_answer(effects: dict[str, dict[str, float]]) -> None:
    datasheet, truth = known_datasheet(seed=3)
    nu = nuisance(datasheet)
    o = observe(sweep(true_rig(truth), lines(14), 0.1, seed=1), nu.rig)
    base = with_effects(nu.rig, effects)
    theta = 0.3 * np.random.default_rng(5).standard_normal(len(nu))
    answer, J = answer_and_jacobian(nu, nu.at(theta, base), o)
    np.testing.assert_allclose(answer, linear_answer(nu.at(theta, base), o), rtol=0, atol=0)
    step = 1e-4
    for j, name in enumerate(nu.names):
        e = np.zeros(len(nu))
        e[j] = step
        ahead = linear_answer(nu.at(theta + e, base), o)
        difference = (ahead - linear_answer(nu.at(theta - e, base), o)) / (2 * step)
        size = np.linalg.norm(difference)
        assert np.linalg.norm(J[:, :, j] - difference) < 2e-3 * size, name
