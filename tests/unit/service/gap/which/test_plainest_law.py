"""Of a law and a plainer one that the data do not tell apart, the plainer one is told."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.which.explained import Explained
from service.gap.which.plainest_law import plainer_law, plainer_laws
from service.gap.which.search import explain
from sim.twin import with_effects
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig

pytestmark = pytest.mark.slow


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


def test_explanations_together_are_as_each_alone() -> None:
    datasheet, truth = known_datasheet(seed=4)
    nu = nuisance(datasheet)
    rig = with_effects(true_rig(truth), {"sensor_lag": {"time_constant_s": 8e-6, "delay_s": 0.0}})
    o = observe(sweep(rig, lines(30), 0.4, 3, 3.0), nu.rig)
    ground = Ground(nu, parts(nu, (o,))[-1], (o,), np.zeros(len(nu)))
    gain = dict.fromkeys(("gain_change_xA", "gain_change_yA", "gain_change_xB", "gain_change_yB"), 0.01)
    with Fitter(1) as fitter:
        free = fitter.run(
            [Task(ground, (e,), ((s,),), ground.theta) for e, s in [("sensor_lag", BOTH), ("sensor_gain", gain)]]
        )
        alone, together = [plainer_law(fitter, ground, c) for c in free], plainer_laws(fitter, ground, free)
    assert [c.effects for c in together] == [("sensor_lag",), ("sensor_gain",)]
    assert [c.fit.values for c in together] == [c.fit.values for c in alone]


def test_of_three_shapes_the_two_that_are_not_needed_are_left_out_together() -> None:
    warm = {"ki_change": -0.05, "ks_change": -0.07, "duration_s": 300.0, "curvature": 5.0}
    begun = {**warm, "end_imbalance": 0.1, "plane_imbalance": 0.1}
    free, plain = fitted(warm, begun, noise=1.0, effect="thermal_drift")
    assert free.fit.values[0]["end_imbalance"] != 0 != free.fit.values[0]["plane_imbalance"]
    found = plain.fit.values[0]
    assert (found["end_imbalance"], found["plane_imbalance"]) == (0.0, 0.0)
    assert found["curvature"] == pytest.approx(5.0, rel=0.25)


SLOW = {"frequency_change": -0.035, "damping_change": 0.0, "lag_s": 0.0, "end_imbalance": 0.0, "plane_imbalance": 0.0}


def of_amplifiers(changes: tuple[float, float, float, float], effects: dict[str, dict[str, float]]) -> Ground:
    """Amplifiers whose frequencies are these shares off a datasheet with a tolerance of 1 %."""
    _, truth = known_datasheet(seed=4)
    stated = zip(truth.amplifier_natural_frequency_hz, changes, strict=True)
    nu = nuisance(replace(truth, amplifier_natural_frequency_hz=tuple(f / (1 + change) for f, change in stated)))
    o = observe(sweep(with_effects(true_rig(truth), effects), lines(30), 0.4, 1, noise=4.0), nu.rig)
    part = next(p for p in parts(nu, (o,)) if p.path == "amplifier")
    return Ground(nu, part, (o,), np.zeros(len(nu)))


def amplifiers(changes: tuple[float, float, float, float], effects: dict[str, dict[str, float]]) -> Explained:
    """What is found in them."""
    with Fitter(1) as fitter:
        return explain(fitter, of_amplifiers(changes, effects))


@pytest.mark.parametrize("change", [-0.031, -0.034])
def test_amplifiers_all_slow_by_what_each_may_be_by_chance_are_slow(change: float) -> None:
    """Their law has lags, dampings and shares too: that these are nothing is no chance to be paid for."""
    best = amplifiers((0.0, 0.0, 0.0, 0.0), {"amplifier_bandwidth": {**SLOW, "frequency_change": change}}).order[0]
    assert best.candidate.effects == ("amplifier_bandwidth",)
    assert best.probability > 0.9
    values = best.candidate.fit.values[0]
    assert values["frequency_change"] == pytest.approx(change, abs=0.01)
    assert values["lag_s"] == 0.0


def test_a_lag_that_the_data_show_is_not_left_out_together_with_shapes_that_they_do_not() -> None:
    """Four standard deviations of it are no chance, however many more parameters explain nothing."""
    rig = {"amplifier_bandwidth": {**SLOW, "frequency_change": 0.04, "lag_s": 1e-6}}
    best = amplifiers((0.0, 0.0, 0.0, 0.0), rig).order[0].candidate
    (values,), (deviations,) = best.fit.values, best.standard_deviations
    assert abs(values["lag_s"] - 1e-6) < 2 * deviations["lag_s"] < 1e-6
    assert [values[shape] for shape in ("damping_change", "end_imbalance", "plane_imbalance")] == [0.0, 0.0, 0.0]


def test_what_a_fit_left_above_its_optimum_is_no_reason_to_leave_a_lag_out() -> None:
    """Datasheet and effect change the same frequencies: along that valley a fit may end some chi-square too high."""
    rig = {"amplifier_bandwidth": {**SLOW, "frequency_change": 0.04, "lag_s": 1e-6}}
    ground = of_amplifiers((0.0, 0.0, 0.0, 0.0), rig)
    with Fitter(1) as fitter:
        (free,) = fitter.run([Task(ground, ("amplifier_bandwidth",), ((rig["amplifier_bandwidth"],),), ground.theta)])
        above = replace(free, fit=replace(free.fit, penalty=free.fit.penalty + 12.0))
        assert plainer_law(fitter, ground, above).fit.values[0]["lag_s"] > 0


@pytest.mark.parametrize("changes", [(0.01, -0.015, 0.005, -0.01), (-0.02, -0.01, 0.0, -0.01), (0.0, 0.0, 0.025, 0.0)])
def test_amplifiers_that_are_off_as_tolerances_allow_are_no_effect(changes: tuple[float, float, float, float]) -> None:
    assert amplifiers(changes, {}).order[0].candidate.effects == ()
