"""Which sweeps of an experiment a diagnosis uses."""

from dataclasses import replace

import numpy as np

from service.gap.measured.observation import observe
from service.gap.measured.sweeps import best_check, halves, sweeps_for
from tests.support.synthetic import experiment, known_datasheet, true_rig

RIG = true_rig(known_datasheet()[1])
MEASURED = experiment(RIG)
MAIN, LOUDER = MEASURED.sweeps


def test_sweeps_of_the_amplifiers_and_the_record_at_rest_are_left_out() -> None:
    still, amplifiers = replace(MAIN, kind="noise"), replace(MAIN, comment="amplifier")
    named = sweeps_for(replace(MEASURED, sweeps=(still, amplifiers, MAIN, LOUDER)))
    assert [name for name, _ in named] == ["sweeps/2", "sweeps/3"]


def test_of_several_sweeps_the_first_at_another_condition_is_the_one_to_check_on() -> None:
    others = [("sweeps/1", MAIN), ("sweeps/2", LOUDER), ("sweeps/3", LOUDER)]
    (name, _), unused = best_check(MAIN, others, RIG)
    assert name == "sweeps/2"
    assert unused == ["sweeps/1", "sweeps/3"]
    assert best_check(MAIN, others[:1], RIG) == (others[0], [])


def test_no_line_of_the_half_that_no_fit_sees_is_fitted_however_few_there_are() -> None:
    few = observe(LOUDER.select(np.isin(LOUDER.frequency_hz, np.unique(LOUDER.frequency_hz)[:3])), RIG)
    both = halves(few, "sweeps/1")
    assert both is not None
    seen, unseen, name = both
    assert not set(seen.frequency_hz) & set(unseen.frequency_hz)
    assert len(seen.frequency_hz) + len(unseen.frequency_hz) == 3
    assert name == "sweeps/1, every other line"
    assert halves(few.select(np.array([True, False, False])), "sweeps/1") is None
