"""Of a law and a plainer one that the data do not tell apart, the plainer one is told."""

import numpy as np
import pytest

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.which.plainest_law import plainer_law
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.no_cover  # other tests cover the lines; traced they take a third longer


def fitted(
    values: dict[str, float], begun: dict[str, float], noise: float, effect: str = "sensor_lag"
) -> tuple[Candidate, Candidate]:
    """A sensor that lags, or another effect, as it is fitted from somewhere, and the plainest law of that."""
    datasheet, truth = known_datasheet(seed=4)
    nu = nuisance(datasheet)
    rig = with_effects(true_rig(truth), {effect: values})
    o = observe(sweep(rig, lines(30), 0.4, 3, noise), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    with Fitter(1) as fitter:
        (free,) = fitter.run([Task(ground, (effect,), ((begun,),), np.zeros(len(nu)))])
        return free, plainer_law(fitter, ground, free)


BOTH = {"time_constant_s": 3e-6, "delay_s": 5e-6}


def test_a_pole_is_not_shared_with_a_delay_that_does_as_well() -> None:
    lag_s = 8e-6
    free, plain = fitted({"time_constant_s": lag_s, "delay_s": 0.0}, BOTH, noise=3.0)
    assert free.fit.values[0]["delay_s"] > 0
    values = plain.fit.values[0]
    assert (values["time_constant_s"], values["delay_s"]) == (pytest.approx(lag_s, rel=0.05), 0.0)
    assert plain.standard_deviations == free.standard_deviations


def test_a_delay_that_a_pole_does_not_explain_stays_one() -> None:
    delay_s = 3e-5
    free, plain = fitted({"time_constant_s": 1e-7, "delay_s": delay_s}, BOTH, noise=1.0)
    assert plain is free
    assert plain.fit.values[0]["delay_s"] == pytest.approx(delay_s, rel=0.1)


def test_of_three_shapes_the_two_that_are_not_needed_are_left_out_together() -> None:
    warm = {"ki_change": -0.05, "ks_change": -0.07, "duration_s": 300.0, "curvature": 5.0}
    begun = {**warm, "end_imbalance": 0.1, "plane_imbalance": 0.1}
    free, plain = fitted(warm, begun, noise=1.0, effect="thermal_drift")
    assert free.fit.values[0]["end_imbalance"] != 0 != free.fit.values[0]["plane_imbalance"]
    found = plain.fit.values[0]
    assert (found["end_imbalance"], found["plane_imbalance"]) == (0.0, 0.0)
    assert found["curvature"] == pytest.approx(5.0, rel=0.25)
