"""What is known of a gap from the twin's own effects is doubted like any other verdict."""

import pytest

from service.gap.measured.observation import observe
from service.gap.overall_verdict import overall_verdict
from service.gap.weighing.verdict import Verdict
from tests.support.synthetic import experiment, known_datasheet, true_rig

RIG = true_rig(known_datasheet(seed=6)[1])
MAIN, OTHER = (observe(s, RIG) for s in experiment(RIG).sweeps)
CONFIRMED = Verdict("no_gap", (), (), 0.96, ("the law of eddy currents comes no nearer",))


def test_effects_that_the_rig_shows_as_named_stand_where_nothing_speaks_against_them() -> None:
    assert overall_verdict([], MAIN, OTHER, 1e-3, given=CONFIRMED) == CONFIRMED


@pytest.mark.parametrize("doubt", ["fault", "swings", "tone"])
def test_a_rig_that_shows_the_effects_of_its_twin_may_still_have_another_fault(doubt: str) -> None:
    words = "the displacement is cut off"
    found = overall_verdict([], MAIN, OTHER, 1e-3, given=CONFIRMED, **{doubt: words})  # type: ignore[arg-type]
    assert found.kind == "none_of_these"
    assert words in found.reasons[-1]
