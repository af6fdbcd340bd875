"""From what explanations leave to a verdict: what is told when an explanation does not explain."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.candidates import Candidate
from service.gap.fit import Fit
from service.gap.verdict import Ranked, decide
from sim.reference import reference_rig

RIG = reference_rig()


def explanation(effects: tuple[str, ...], evidence: float, left: float, shares: tuple[float, ...]) -> Ranked:
    groups = ((1.0, 1), (1.0, 1))
    fit = Fit(effects, np.zeros(1), tuple({} for _ in effects), RIG, groups, 0.0, np.arange(1), np.eye(1), "converged")
    return Ranked(Candidate(effects, fit, 0.0, tuple({} for _ in effects)), evidence, 0.9, left, shares)


PLAIN = explanation((), -100.0, 1.0, (1.0, 0.0, 1.0, 0.0))


def said(best: Ranked, remaining: float, closure: float | None = 0.95) -> str:
    return decide([best, PLAIN], remaining, closure, significant=50.0).kind


def test_an_explanation_that_leaves_little_is_named() -> None:
    assert said(explanation(("rotor_inertia",), 0.0, 0.01, (0.01, 0.0, 0.02, 0.0)), remaining=12.0) == "effect"


def test_an_explanation_of_one_sweep_only_is_none() -> None:
    """What answers to the excitation in proportion cannot be there at one amplitude and not at the other."""
    one_only = explanation(("extra_flexible_mode",), 0.0, 0.2, (0.66, 0.0, 0.01, 0.0))
    assert said(one_only, remaining=20.0) == "none_of_these"
    assert said(replace(one_only, shares=(0.01, 0.0, 0.66, 0.0)), remaining=20.0) == "none_of_these"


def test_harmonics_of_another_law_of_the_same_effect_may_be_left() -> None:
    assert said(explanation(("rotor_inertia",), 0.0, 0.01, (0.01, 0.6, 0.01, 0.5)), remaining=12.0) == "effect"


@pytest.mark.parametrize("remaining", [1.0, 5.0])
def test_what_is_left_must_be_significant_to_count(remaining: float) -> None:
    assert said(explanation(("rotor_inertia",), 0.0, 0.2, (0.4, 0.0)), remaining) == "effect"


def test_nothing_named_and_much_left_is_none_of_these() -> None:
    assert decide([PLAIN], 20.0, None, significant=30.0).kind == "none_of_these"
    assert decide([PLAIN], 2.0, None, significant=30.0).kind == "no_gap"
