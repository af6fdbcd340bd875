"""Two effects of one part of the loop: both are named, whatever each of them explains alone."""

import numpy as np
import pytest

from service.gap.candidates import Candidate
from service.gap.diagnose import diagnose
from service.gap.fitted import Fit
from service.gap.search import _worth_it
from service.gap.verdict import Ranked
from sim.reference import reference_rig
from sim.twin import with_effects
from tests.support.synthetic import experiment, known_datasheet, true_rig

pytestmark = pytest.mark.no_cover  # other tests cover the lines; traced they take a third longer


RIG = reference_rig()
CROSS, AWAY = "magnetic_cross_coupling", "off_centre_rotor"


def explanation(effects: tuple[str, ...], evidence: float, shares: tuple[float, float]) -> Ranked:
    fit = Fit(effects, np.zeros(1), (), RIG, (), 0.0, np.arange(1), np.eye(1), "converged")
    return Ranked(Candidate(effects, fit, 0.0, ()), evidence, 0.9, max(shares), shares)


def test_of_two_effects_one_may_make_the_fundamental_s_gap_and_the_other_that_of_the_harmonics() -> None:
    both = explanation((CROSS, AWAY), -10.0, (0.01, 0.01))
    singles = [explanation((CROSS,), -90.0, (0.01, 1.0)), explanation((AWAY,), -99.0, (1.0, 0.01))]
    assert _worth_it(both, [both, *singles])


def test_a_second_effect_that_one_alone_makes_needless_is_not_worth_it() -> None:
    both = explanation((CROSS, AWAY), -10.0, (0.009, 0.008))
    enough = explanation((CROSS,), -15.0, (0.01, 0.01))
    useless = explanation((AWAY,), -99.0, (1.0, 0.5))
    assert not _worth_it(both, [both, enough, useless])


def test_an_effect_that_is_likely_but_explains_little_is_named_with_the_one_that_explains_the_rest() -> None:
    """Alone the other explains most, by a datasheet that is far off, and so is the less likely of the two."""
    datasheet, truth = known_datasheet(seed=21)
    iron = {"time_constant_s": 1.7e-6, "corner_rad_s": 1.0}
    both = {"eddy_currents": iron, CROSS: {"rotation_rad": 0.0, "symmetric_share": -0.04}}
    d = diagnose(experiment(with_effects(true_rig(truth), both)), datasheet)
    assert set(d.verdict.effects) == set(both)
    assert d.shrinkage.closure is not None
    assert d.shrinkage.closure > 0.95
