"""A voltage limit that is told by a lost loop takes the place of the one that no fit could see."""

import numpy as np
import pytest

from service.gap.compose import Composition
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import nuisance
from service.gap.lost_loop import LIMIT, SLEW_INVERSE, LostLoop, with_limit
from service.gap.weighing.ranking import Ranked
from sim.effects import CATALOGUE
from tests.support.synthetic import known_datasheet

NUISANCE = nuisance(known_datasheet(seed=2)[0])


def fitted(*effects: str) -> Ranked:
    """A twin with these effects at typical values, its voltage limit where its range ends."""
    values = tuple({p.name: p.typical for p in CATALOGUE[name].parameters} for name in effects)
    theta, none = np.zeros(len(NUISANCE)), np.zeros((len(NUISANCE), len(NUISANCE)))
    ends = {(name, SLEW_INVERSE): "high" for name in effects if name == LIMIT}
    fit = Fit(effects, theta, values, NUISANCE.rig, ((1.0, 1),), 0.0, np.arange(len(NUISANCE)), none, "", ends=ends)
    deviations = tuple(dict.fromkeys(v, 1.0) for v in values)
    return Ranked(Candidate(effects, fit, 0.0, deviations), 0.0, 0.5, 0.1, open_strength=(LIMIT,))


@pytest.mark.parametrize("effects", [(LIMIT,), (LIMIT, "sensor_lag"), ("sensor_lag", LIMIT)])
def test_the_limit_is_stated_between_both_slopes_and_named_last(effects: tuple[str, ...]) -> None:
    """Whichever part has the larger gap: the verdict names it after what was fitted."""
    (r,) = with_limit(Composition((fitted(*effects),)), NUISANCE, LostLoop("", (3000.0, 4000.0))).order
    c = r.candidate
    assert c.effects == c.fit.effects == (*(name for name in effects if name != LIMIT), LIMIT)
    assert 3000.0 < 1 / c.fit.values[-1][SLEW_INVERSE] < 4000.0
    assert c.standard_deviations[-1][SLEW_INVERSE] < 0.15 * c.fit.values[-1][SLEW_INVERSE]
    assert c.fit.rig.amplifiers.slew_limit_a_per_s == pytest.approx(1 / c.fit.values[-1][SLEW_INVERSE])
    if "sensor_lag" in effects:
        assert c.fit.values[0]["time_constant_s"] == CATALOGUE["sensor_lag"].parameters[0].typical
    assert not c.fit.ends, "no fit ended there"
    assert r.open_strength == ()


def test_without_slopes_on_both_sides_nothing_is_stated() -> None:
    whole = Composition((fitted(LIMIT),))
    assert with_limit(whole, NUISANCE, LostLoop("", None)) is whole
