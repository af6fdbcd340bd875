"""A drift that was found is stated over the time that the experiment took."""

from dataclasses import replace

import numpy as np
import pytest

from service.gap.compose import Composition
from service.gap.document import stated
from service.gap.drift_rate import with_drift_rate
from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.weighing.ranking import Ranked
from sim.effects import CATALOGUE
from sim.reference import reference_rig

RIG, DRIFT = reference_rig(), CATALOGUE["thermal_drift"]
FOUND = {"ki_change": -0.04, "ks_change": -0.02, "duration_s": 300.0, "curvature": 0.0}


def found() -> Composition:
    fit = Fit(("thermal_drift",), np.zeros(1), (FOUND,), DRIFT.on(RIG, **FOUND), (), 0.0, np.arange(1), np.eye(1), "")
    spread = (dict.fromkeys(FOUND, 0.001),)
    return Composition((Ranked(Candidate(fit.effects, fit, 0.0, spread), 0.0, 1.0, 0.0),))


@pytest.mark.parametrize(("campaign_s", "stated_s"), [(1200.0, 1200.0), (72_000.0, 36_000.0)])
def test_its_rate_is_that_of_the_campaign_and_its_time_one_that_a_twin_takes(
    campaign_s: float, stated_s: float
) -> None:
    candidate = with_drift_rate(found(), RIG, campaign_s).order[0].candidate
    values = candidate.fit.values[0]
    assert values["duration_s"] == stated_s
    for name in ("ki_change", "ks_change"):
        assert values[name] / stated_s == pytest.approx(FOUND[name] / campaign_s)
        spread = candidate.standard_deviations[0][name]
        assert spread / values[name] == pytest.approx(0.001 / FOUND[name]), "as sure as it was"
    DRIFT.on(RIG, **values)


def test_the_time_is_told_as_given_and_not_as_found() -> None:
    """Nothing was fitted that has a deviation of 0."""
    told = stated(with_drift_rate(found(), RIG, 1200.0).order[0].candidate)
    assert told["duration_s"] == {"value": 1200.0, "std": 0.0, "at_bound": None, "given": True}
    assert told["ki_change"] == {"value": FOUND["ki_change"], "std": 0.001, "at_bound": None}
    assert not any("given" in e for e in stated(found().order[0].candidate).values())


def test_what_a_fit_held_is_not_told_as_known_exactly() -> None:
    candidate = found().order[0].candidate
    held = replace(candidate, standard_deviations=({**candidate.standard_deviations[0], "curvature": 0.0},))
    assert stated(held)["curvature"]["std"] is None
    assert stated(held)["ki_change"]["std"] == 0.001


def test_without_a_clock_or_beside_a_drift_of_the_datasheet_it_stays_as_it_is() -> None:
    assert with_drift_rate(found(), RIG, None).order[0].candidate.fit.values[0] == FOUND
    drifting = DRIFT.on(RIG, **FOUND)
    assert with_drift_rate(found(), drifting, 1200.0).order[0].candidate.fit.values[0] == FOUND
