"""A datasheet that is far off is another rig's only where it leaves as much as another rig's does."""

import pytest

from service.gap.weighing.another_rig import with_datasheet_off
from service.gap.weighing.verdict import Verdict

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
