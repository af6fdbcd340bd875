"""A linear effect explains no gap that changes with amplitude, however well it fits at one."""

from dataclasses import replace

import pytest

from service.gap.doubts.amplitude_dependent import changes_with_amplitude
from service.gap.overall_verdict import verdict_of
from service.gap.weighing.verdict import HeldOut
from service.gap.which.explained import Explained
from tests.unit.service.gap.where.test_dependence import plant

LEFT = HeldOut(before=50.0, after=10.0, gap=40.0, left=20.0, closes=0.8)
"""On the other sweep an explanation closes most of the gap, and leaves something."""


def named(e: Explained, *effects: str) -> Explained:
    """The part with such effects as its best explanation."""
    best = replace(e.order[0], candidate=replace(e.order[0].candidate, effects=effects))
    return replace(e, order=(best, *e.order))


@pytest.mark.parametrize("effects", [("eddy_currents",), ("sensor_lag", "sensor_position")])
def test_linear_effects_are_rejected_where_the_gap_changes_with_amplitude(effects: tuple[str, ...]) -> None:
    e, other = plant("bent")
    told = changes_with_amplitude(named(e, *effects), other, LEFT)
    assert told is not None
    assert " and ".join(name.replace("_", " ") for name in effects) in told


def test_what_may_change_with_amplitude_or_in_time_and_a_gap_that_does_not_are_not_rejected() -> None:
    (bent, louder), (linear, as_loud) = plant("bent"), plant("linear")
    for effects in (("magnetic_saturation",), ("eddy_currents", "magnetic_hysteresis"), ("thermal_drift",), ()):
        assert changes_with_amplitude(named(bent, *effects), louder, LEFT) is None
    assert changes_with_amplitude(named(linear, "sensor_lag"), as_loud, LEFT) is None


def test_another_speed_may_change_it_too() -> None:
    e, other = plant("bent")
    assert changes_with_amplitude(named(e, "sensor_lag"), replace(other, speed_rad_s=300.0), LEFT) is None


def test_an_explanation_that_leaves_nothing_on_either_sweep_stays() -> None:
    e, other = plant("bent")
    explained = replace(named(e, "sensor_lag"), left=plant("none")[0].plain)
    assert changes_with_amplitude(explained, other, replace(LEFT, left=1.0)) is None
    assert changes_with_amplitude(explained, other, LEFT) is not None


def test_the_verdict_is_none_of_these_then(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever else may be said of such a gap."""
    monkeypatch.setattr("service.gap.overall_verdict._nonlinear_cause", lambda *_: None)
    e, other = plant("bent")
    fits_well = replace(named(e, "sensor_lag"), left=plant("none")[0].plain)
    best = replace(fits_well.order[0], unexplained=0.01, shares=(0.01, 0.0), probability=0.97)
    verdict = verdict_of([replace(fits_well, order=(best, *e.order))], {"plant": LEFT}, other)
    assert verdict.kind == "none_of_these"
    assert verdict.nonlinear
    assert "at another amplitude" in verdict.reasons[0]
