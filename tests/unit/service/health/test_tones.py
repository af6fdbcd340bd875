"""The short plan: few tones, well placed."""

import numpy as np
import pytest

from service.campaign.frequencies import mains_harmonics
from service.errors import JobError
from service.health import tones
from service.identification.result.saved import saved_planes
from tests.support.commissioned import SHEET, plan, result


def test_the_plan_is_short_and_keeps_off_the_mains():
    found = plan()
    f = np.array(found.profile.frequencies_hz)
    assert tones.FEWEST <= len(f) <= tones.MOST
    assert np.all(np.diff(f) > 0)
    assert found.expected_s <= 75.0
    mains = mains_harmonics(1100.0)
    assert np.abs(f[:, None] - mains).min() > 0.29


def test_every_mode_has_tones_within_a_few_of_its_widths():
    f = np.array(plan().profile.frequencies_hz)
    for s in saved_planes(result(), SHEET).values():
        for mode in s.model.modes:
            assert np.abs(f - mode[0] / (2 * np.pi)).min() < 6 * mode[1] / (2 * np.pi)


def test_chosen_tones_tell_more_than_as_many_on_a_logarithmic_grid():
    saved = saved_planes(result(), SHEET)["x"]
    design = tones._Design(saved, SHEET)
    chosen = np.array(plan().profile.frequencies_hz)
    grid = np.geomspace(10, 1000, len(chosen))
    design.prepare(np.concatenate([chosen, grid]))
    n = len(chosen)
    best, plain = (design.std_percent(list(k)) for k in (range(n), range(n, 2 * n)))
    ratios = {name: plain[name] / best[name] for name in best}
    assert ratios["x.zeta1"] > 3
    assert ratios["x.zeta2"] > 3
    assert np.exp(np.mean(np.log(list(ratios.values())))) > 1.3


def test_the_plan_says_how_well_it_will_tell():
    std = plan().std_percent
    assert 0.005 < std["x.kiA"] < 0.5
    assert std["y.wn1"] < 0.01
    document = plan().document()
    assert document["expected_std_percent"] == std
    assert document["frequencies_hz"] == list(plan().profile.frequencies_hz)


def test_too_small_a_budget_is_refused_with_the_least_that_will_do():
    with pytest.raises(JobError, match=r"budget_s of at least \d+$") as refused:
        tones.short_plan(SHEET, result(), 25.0)
    assert refused.value.title == "budget too small"
    least = float(str(refused.value).rpartition(" ")[2])
    found = tones.short_plan(SHEET, result(), least)
    assert len(found.profile.frequencies_hz) >= tones.FEWEST
    assert found.expected_s <= 1.02 * least
    exact = tones._Times(SHEET, result()).least
    assert least - 1 < exact <= least
    for budget_s in (exact, exact * (1 - 1e-12)):  # by rounding alone it holds fewer
        assert len(tones.short_plan(SHEET, result(), budget_s).profile.frequencies_hz) >= tones.FEWEST


def test_a_rig_that_no_permitted_budget_holds_is_not_told_to_take_a_larger_one(monkeypatch):
    monkeypatch.setattr(tones, "REPEATED", 500.0)
    with pytest.raises(JobError, match="more than the 3600 s of any check: commission it anew"):
        tones.must_suffice(SHEET, result(), 3600.0)
