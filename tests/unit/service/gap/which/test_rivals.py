"""Damping that a mode has gained may be the shaft's own at rest, but for more than a shaft has."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import Verdict
from service.gap.which.rivals import in_question, turning_with_the_shaft
from sim.effects import CATALOGUE
from sim.twin import linear_model, rig_from_datasheet
from tests.support.synthetic import known_datasheet


def gained(damping_ratio: float, *log_ratios: float) -> Candidate:
    """A twin whose modes have so much more damping than so little, all alike or each its own."""
    sheet = known_datasheet()[0]
    modes = tuple(replace(m, damping_ratio=damping_ratio) for m in sheet.modes)
    values = {"mode1_log_ratio": log_ratios[0], "mode2_log_ratio": log_ratios[-1]}
    rig = CATALOGUE["modal_damping"].on(rig_from_datasheet(replace(sheet, modes=modes)), **values)
    fit = Fit(("modal_damping",), np.zeros(1), (values,), rig, (), 0.0, np.arange(1), np.eye(1), "")
    return Candidate(fit.effects, fit, 0.0, ({},))


@pytest.mark.parametrize("log_ratios", [(2.0,), (2.0, 0.5), (0.0, 2.0), (2.0, -0.3)])
def test_it_is_the_same_rig_at_rest(log_ratios: tuple[float, ...]) -> None:
    """What a mode has lost stays a loss outside the shaft."""
    c = gained(0.001, *log_ratios)
    internal = turning_with_the_shaft(c)
    assert internal is not None
    assert internal.effects == ("internal_damping",)
    hz = np.geomspace(10.0, 1000.0, 50)
    np.testing.assert_allclose(
        linear_model(internal.fit.rig, hz).y_per_u, linear_model(c.fit.rig, hz).y_per_u, rtol=1e-9
    )


def test_damping_that_already_turned_stays_as_it_was() -> None:
    c = gained(0.001, 2.0, 0.5)
    turning = CATALOGUE["internal_damping"].on(c.fit.rig, damping_ratio=2e-3, mode_imbalance=0.0)
    c = replace(c, fit=replace(c.fit, rig=turning))
    internal = turning_with_the_shaft(c)
    assert internal is not None
    hz = np.geomspace(10.0, 1000.0, 50)
    np.testing.assert_allclose(linear_model(internal.fit.rig, hz).y_per_u, linear_model(turning, hz).y_per_u, rtol=1e-9)


@pytest.mark.parametrize(("damping_ratio", "log_ratio"), [(0.001, 3.5), (0.005, 2.2), (0.01, 1.6)])
def test_more_than_a_shaft_loses_inside_is_no_rival(damping_ratio: float, log_ratio: float) -> None:
    assert turning_with_the_shaft(gained(damping_ratio, log_ratio)) is None


def test_every_explanation_that_the_classes_leave_is_in_question() -> None:
    """A rotor must be safe with any of them, not only with the likeliest two."""
    base = gained(0.001, 1.0)

    def ranked(*effects: str) -> Ranked:
        return Ranked(replace(base, effects=effects, fit=replace(base.fit, effects=effects)), 0.0, 0.1, 0.0)

    order = [
        ranked("eddy_currents", "sensor_gain"),
        ranked("loop_delay", "sensor_gain"),
        ranked("sensor_gain"),
        ranked(),
    ]
    order.append(ranked("sensor_gain", "sensor_lag"))
    group = ("eddy_currents", "sensor_lag", "loop_delay")
    verdict = Verdict("effects", ("eddy_currents", "sensor_gain"), (group,), 0.9, ())
    assert [set(c.effects) - {"sensor_gain"} for c in in_question(order, verdict)] == [{name} for name in group]
