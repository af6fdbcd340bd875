"""When effects are asked for the axis they are in: where the same on all axes leaves much, also below the noise."""

import numpy as np

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.weighing.ranking import ranked
from service.gap.which.search import leaves_much
from sim.reference import reference_rig

RIG = reference_rig()


def explained(effects: tuple[str, ...], *left: float) -> Candidate:
    """An explanation that leaves so much chi-square of two sweeps of 1000 values each, whose noise is 600."""
    groups = tuple((chi, 1000) for chi in left)
    fit = Fit(effects, np.zeros(1), tuple({} for _ in effects), RIG, groups, 0.0, np.arange(1), np.eye(1), "")
    return Candidate(effects, fit, 0.0, tuple({} for _ in effects))


def test_an_effect_that_leaves_what_others_show_to_be_no_noise_leaves_much() -> None:
    null, drift = explained((), 620.0, 900.0), explained(("thermal_drift",), 600.0, 790.0)
    half = explained(("magnetic_saturation",), 615.0, 740.0)
    other = explained(("magnetic_hysteresis",), 640.0, 600.0)
    assert leaves_much(null, ranked(null, [half, drift, other]))


def test_what_leaves_next_to_nothing_and_the_plain_twin_itself_do_not() -> None:
    null = explained((), 620.0, 900.0)
    whole = explained(("magnetic_saturation",), 601.0, 605.0)
    assert not leaves_much(null, ranked(null, [whole, explained(("thermal_drift",), 600.0, 790.0)]))
    assert not leaves_much(null, ranked(null, [explained(("thermal_drift",), 619.0, 899.0)]))
