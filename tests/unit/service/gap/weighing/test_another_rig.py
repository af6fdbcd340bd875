"""A datasheet that is far off is another rig's only where it leaves as much as another rig's does."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.overall_verdict import verdict_of
from service.gap.weighing.another_rig import drawn_by_its_law, free_body, with_datasheet_off
from service.gap.weighing.verdict import HeldOut, Verdict
from sim.effects import CATALOGUE
from tests.support.synthetic import known_datasheet, lines, sweep, true_rig
from tests.unit.service.gap.where.test_dependence import plant

AWAY = "its values would be off by many tolerances (mass by +4.0)"
UNKNOWN = Verdict("none_of_these", (), (), 0.97, ("the best explanation leaves 73 % of the gap",))
NAMED = Verdict("effect", ("eddy_currents",), (), 0.99, ())


@pytest.mark.parametrize("found", [UNKNOWN, NAMED, Verdict("no_gap", (), (), 0.9, ())])
def test_a_large_gap_is_another_rigs(found: Verdict) -> None:
    verdict = with_datasheet_off(found, AWAY, relative_gap=0.1)
    assert (verdict.kind, verdict.effects, verdict.another_rig) == ("none_of_these", (), True)
    assert "of another rig" in verdict.reasons[0]
    assert AWAY in verdict.reasons[0]


def test_a_small_gap_that_nothing_explains_stays_one_of_this_rig() -> None:
    """What nothing describes draws the datasheet's values away too: half a per cent of it is no other rotor."""
    verdict = with_datasheet_off(UNKNOWN, AWAY, relative_gap=0.005)
    assert not verdict.another_rig
    assert verdict.reasons[0] == UNKNOWN.reasons[0]
    assert AWAY in verdict.reasons[1], "it may be the datasheet all the same"


def test_what_bends_is_told_before_the_values_that_it_draws_away() -> None:
    bent = Verdict("none_of_these", (), (), 0.95, ("the displacement is curved",), nonlinear=True)
    verdict = with_datasheet_off(bent, AWAY, relative_gap=0.1)
    assert not verdict.another_rig
    assert verdict.reasons[0] == bent.reasons[0]
    assert AWAY in verdict.reasons[1]


def test_a_small_gap_is_explained_by_no_effect_that_needs_another_datasheet() -> None:
    verdict = with_datasheet_off(NAMED, AWAY, relative_gap=0.005)
    assert (verdict.kind, verdict.effects, verdict.another_rig) == ("none_of_these", (), False)
    assert "eddy currents" in verdict.reasons[0]
    assert AWAY in verdict.reasons[0]


@pytest.mark.parametrize(
    ("effect", "hz", "end", "another_body"),
    [
        ("support_resonance", 5.0, "low", True),
        ("extra_flexible_mode", 10.0, "low", True),  # of which the lowest line is the end
        ("support_resonance", 6.0, None, False),  # the fit has found it, below the lines as it is
        ("support_resonance", 1500.0, "high", False),
        ("extra_flexible_mode", 12.0, "low", False),  # within the lines
    ],
)
def test_a_resonance_that_a_fit_wants_below_every_line_is_another_rotor(
    effect: str, hz: float, end: str | None, another_body: bool
) -> None:
    sheet = known_datasheet()[0]
    rig, law = true_rig(sheet), CATALOGUE[effect]
    o = observe(sweep(rig, lines(12), 0.15, seed=1), rig)
    nu = nuisance(sheet)
    plant = next(p for p in parts(nu, (o,)) if p.path == "plant")
    values = {p.name: p.typical for p in law.parameters} | {"frequency_hz": hz}
    ends = {} if end is None else {(effect, "frequency_hz"): end}
    fit = Fit((effect,), np.zeros(1), (values,), rig, (), 0.0, np.arange(1), np.eye(1), "", ends=ends)
    told = free_body(Ground(nu, plant, (o,), np.zeros(len(nu.names)), ()), fit)
    assert (told is not None) == another_body
    assert not another_body or "mass_kg or transverse_inertia_kgm2" in (told or "")


@pytest.mark.parametrize(
    ("effect", "unexplained", "stands"),
    [
        ("touchdown_contact", 0.01, True),
        ("amplifier_voltage_limit", 0.01, True),
        ("touchdown_contact", 0.04, False),  # more than a law's error leaves: it may be no stop
        ("support_resonance", 0.01, False),  # it has no scale of its own that a wrong mass could not have
    ],
)
def test_what_a_bending_law_leaves_of_a_gross_gap_makes_no_datasheet_another_rigs(
    monkeypatch: pytest.MonkeyPatch, effect: str, unexplained: float, stands: bool
) -> None:
    """A stop with damping and friction drew every sensor's position as far as it goes, though 0.3 % were left."""
    monkeypatch.setattr("service.gap.overall_verdict.far_off", lambda *_: AWAY)
    for doubt in ("_nonlinear_cause", "changes_with_amplitude", "lag_missing"):
        monkeypatch.setattr(f"service.gap.overall_verdict.{doubt}", lambda *_: None)
    e, other = plant("bent")
    candidate = replace(e.order[0].candidate, effects=(effect,))
    best = replace(
        e.order[0], candidate=candidate, unexplained=unexplained, shares=(unexplained, 0.0), probability=0.97
    )
    there = HeldOut(before=50.0, after=1.0, gap=40.0, left=8.0, closes=0.98)
    verdict = verdict_of([replace(e, order=(best, *e.order))], {"plant": there}, other)
    assert (verdict.effects == (effect,)) is stands
    assert (AWAY in " ".join(verdict.reasons)) is not stands


@pytest.mark.parametrize(
    ("effect", "unexplained", "remaining", "drawn"),
    [
        ("amplifier_voltage_limit", 0.005, 3.0, True),
        ("amplifier_voltage_limit", 0.015, 3.0, False),  # what the values bear is more than a law's error
        ("amplifier_voltage_limit", 0.015, 20.0, True),  # so much is left that tolerances hardly count
        ("support_resonance", 0.005, 20.0, False),
    ],
)
def test_a_bending_law_draws_values_off_where_it_leaves_a_hundredth_with_what_they_bear(
    effect: str, unexplained: float, remaining: float, drawn: bool
) -> None:
    e, _ = plant("bent")
    best = replace(
        e.order[0],
        candidate=replace(e.order[0].candidate, effects=(effect,)),
        unexplained=unexplained,
        shares=(0.0, 0.0),
    )
    assert drawn_by_its_law(best, remaining) is drawn
