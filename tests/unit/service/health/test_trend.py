"""A slow drift shows in the slope before any single check is an alarm."""

import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from service.health.sequential import Policy
from service.health.trend import Checked, allowance, trend
from service.report.health import health_page
from tests.support.browser import BROWSER
from tests.support.tab import tab

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")

START = datetime(2026, 1, 1, 6, tzinfo=UTC)


def history(percent_per_day: float, days: int, offset: float = 0.0, std: float = 0.05, seed: int = 1) -> list[Checked]:
    rng = np.random.default_rng(seed)
    found = []
    for k in range(days):
        change = offset + percent_per_day * k + std * rng.normal()
        total = float(np.hypot(std, 0.05))
        figure = {
            "plane": "x",
            "name": "kiA",
            "unit": "N/A",
            "now": {"value": 180 * (1 + change / 100), "std": 1.8 * std},
            "baseline": {"value": 180.0, "std": 1.8 * 0.05},
            "change_percent": change,
            "change_std_percent": total,
            "significance": change / total,
            "threshold": 4.5,
            "drifted": abs(change) > 4.5 * total,
        }
        document = {
            "rig": "r",
            "alarm": False,
            "drifted": [],
            "sentence": "r: nothing drifted",
            "parameters": {"x.kiA": figure},
            "sensitivity_peak": {},
            "zone": "A",
            "residuals": {"x": {"rms_over_sigma": 1.0, "unexplained": False}},
            "tests_made": k,
            "false_alarms_per_year": 0.2,
            "rig_seconds": 80.0,
            "frequencies_hz": [10.0],
            "checked_at": (START + timedelta(days=k)).isoformat(),
        }
        found.append(Checked(START + timedelta(days=k), document))
    return found


def test_a_slow_drift_is_found_before_any_check_is_an_alarm():
    checks = history(0.006, 40)
    assert not any(c.document["parameters"]["x.kiA"]["drifted"] for c in checks)
    series = trend(checks)["x.kiA"]
    assert series.drifting
    assert series.slope_percent_per_year == pytest.approx(0.006 * 365.25, abs=3 * series.slope_std)


def test_an_error_of_the_baseline_is_no_slope():
    series = trend(history(0.0, 40, offset=0.15))["x.kiA"]
    assert not series.drifting
    assert abs(series.significance) < 3


def against(error_percent: float, checks: list[Checked]) -> list[Checked]:
    """The checks against a baseline that is off by so much."""
    for c in checks:
        figure = c.document["parameters"]["x.kiA"]
        figure["baseline"] = {**figure["baseline"], "value": 180.0 * (1 + error_percent / 100)}
        figure["change_percent"] -= error_percent
    return checks


def test_a_rig_that_is_commissioned_anew_does_not_change_steadily_for_that():
    """The new baseline has another error than the old one: a step, and no slope to either side of it."""
    quiet = history(0.0, 40)
    assert not trend([*against(0.1, quiet[:20]), *against(-0.1, quiet[20:])])["x.kiA"].drifting
    drifts = history(0.01, 40)
    series = trend([*against(-0.1, drifts[:20]), *against(0.1, drifts[20:])])["x.kiA"]
    assert series.drifting
    assert series.slope_percent_per_year == pytest.approx(0.01 * 365.25, abs=3 * series.slope_std)


def test_each_check_is_as_sure_as_its_own_baseline_is_large():
    """A damping ratio that is half as large since the rig was commissioned anew is known half as well, in percent."""
    checks = history(0.0, 12)
    for k, c in enumerate(checks):
        value = 2e-3 if k < 6 else 1e-3
        figure = c.document["parameters"]["x.kiA"]
        figure |= {"now": {"value": value, "std": 1e-5}, "baseline": {"value": value, "std": 2e-5}}
    series = trend(checks)["x.kiA"]
    assert series.std_percent == pytest.approx([0.5] * 6 + [1.0] * 6)
    assert series.baseline_std_percent == pytest.approx(2.0), "of the baseline that holds now"


def test_a_rig_that_is_checked_at_another_speed_does_not_change_steadily_for_that():
    """Gyroscopic coupling moves its modes: a step where the speed changes, and no slope at either one."""
    checks = history(0.0, 40)
    for k, c in enumerate(checks):
        c.document["speed_rad_s"] = 0.0 if k < 20 else 314.0 + 0.3 * (k % 3)
        c.document["parameters"]["x.kiA"]["change_percent"] += 0.0 if k < 20 else 0.3
    assert not trend(checks)["x.kiA"].drifting
    for k, c in enumerate(checks):
        c.document["parameters"]["x.kiA"]["change_percent"] += 0.01 * k
    series = trend(checks)["x.kiA"]
    assert series.drifting
    assert series.slope_percent_per_year == pytest.approx(0.01 * 365.25, abs=3 * series.slope_std)


def test_slopes_of_rigs_that_do_not_drift_are_calibrated():
    found = [trend(history(0.0, 20, seed=k))["x.kiA"].significance for k in range(60)]
    assert 0.6 < np.std(found) < 1.25


def test_checks_that_scatter_more_than_they_say_make_a_slope_less_sure():
    """Its deviation follows from their scatter then, whatever they say of themselves."""
    checks = history(0.0, 20)
    stds = []
    for smaller in (5, 50):
        for c in checks:
            c.document["parameters"]["x.kiA"]["now"]["std"] = 1.8 * 0.05 / smaller
        stds.append(trend(checks)["x.kiA"].slope_std)
    assert stds[0] == pytest.approx(stds[1])
    assert stds[0] == pytest.approx(trend(history(0.0, 20))["x.kiA"].slope_std, rel=0.5)


@pytest.mark.parametrize(("baselines", "known"), [(3, True), (4, False)])
def test_every_baseline_takes_one_check_for_its_level(baselines, known):
    """What is left of the checks beside levels and slope tells the scatter: three at least."""
    checks = history(0.0, 7)
    for k, c in enumerate(checks):
        c.document["parameters"]["x.kiA"]["baseline"] = {"value": 180.0 + k % baselines, "std": 0.09}
    assert (trend(checks)["x.kiA"].slope_std is not None) is known


def with_allowance(checks, per_year):
    return [Checked(c.at, {**c.document, "false_alarms_per_year": per_year}) for c in checks]


def test_a_slope_is_judged_by_the_allowance_that_the_checks_were_made_with():
    """What is enough for one false alarm a year is not for one in a million years."""
    checks = history(0.006, 30)
    lax, strict = (trend(with_allowance(checks, p))["x.kiA"] for p in (1.0, 1e-6))
    assert lax.significance == strict.significance
    assert (lax.drifting, strict.drifting) == (True, False)
    assert trend(checks)["x.kiA"].drifting
    assert not trend(checks, Policy(1e-6))["x.kiA"].drifting, "who asks for another one gets it"
    older = [*with_allowance(checks[:-1], 1e-6), *with_allowance(checks[-1:], 1.0)]
    assert trend(older)["x.kiA"].drifting, "the newest check's counts"
    for per_year, steady in ((1.0, True), (1e-6, False)):
        of = with_allowance(checks, per_year)
        assert ("x.kiA changes steadily" in health_page(of[-1].document, of)) is steady


def test_a_history_of_an_older_version_has_the_usual_allowance():
    checks = history(0.006, 40)
    for c in checks:
        del c.document["false_alarms_per_year"]
    assert allowance(checks) == allowance([]) == Policy()
    assert trend(checks)["x.kiA"].drifting


def test_a_page_tells_the_threshold_of_each_plane():
    """A plane with fewer data has longer tails, and another threshold."""
    (check,) = history(0.0, 1)
    both = {**check.document["parameters"]["x.kiA"], "plane": "y", "threshold": 4.9}
    document = {**check.document, "parameters": {**check.document["parameters"], "y.kiA": both}}
    assert "beyond 4.50 (x-plane) and 4.90 (y-plane) standard deviations" in health_page(document, [check])
    both["threshold"] = 4.501
    assert "beyond 4.50 standard deviations" in health_page(document, [check])


def test_few_checks_have_no_slope():
    series = trend(history(0.0, 3))["x.kiA"]
    assert series.slope_percent_per_year is None
    assert not series.drifting
    assert series.document()["slope_significance"] is None


def test_checks_are_put_in_order():
    checks = history(0.01, 30)
    assert trend(checks[::-1])["x.kiA"].at == trend(checks)["x.kiA"].at


def test_the_page_warns_of_a_steady_change():
    checks = history(0.006, 40)
    page = health_page(checks[-1].document, checks)
    assert "x.kiA changes steadily" in page
    assert 'id="trend-magnets"' in page
    first = health_page(checks[0].document, checks[:1])
    assert "first check" in first


def test_a_figure_that_is_known_to_millionths_is_told_with_its_digits():
    checks = history(0.0, 8, offset=2.1e-4, std=5e-5)
    checks[-1].document["parameters"]["x.kiA"] |= {"change_percent": 2.1e-4, "change_std_percent": 7e-5}
    page = health_page(checks[-1].document, checks)
    told, slope = re.findall(r">([+-][0-9.]+ ± [0-9.]+)<", page)
    assert told == "+0.000210 ± 0.000070"
    assert len(slope.split("± ")[1].lstrip("0.")) == 2
    assert '"exponentformat":"none"' in page, "an axis in % has no 400µ"


def test_the_page_says_first_that_it_is_an_alarm_and_of_which_rig():
    (check,) = history(0.0, 1)
    assert '<p class="lead good">r: nothing drifted</p>' in health_page(check.document, [check])
    document = {**check.document, "alarm": True, "sentence": "r: current stiffness xA -10 %"}
    page = health_page(document, [check])
    assert '<p class="lead bad">ALARM: r: current stiffness xA -10 %</p>' in page
    assert "Checked 2026-01-01 06:00 UTC; " in page


@needs_browser
def test_the_whole_page_is_as_wide_as_a_phone(tmp_path):
    checks = history(0.006, 40)
    file = tmp_path / "page.html"
    file.write_text(health_page(checks[-1].document, checks))
    with tab() as phone:
        phone.narrow(390)
        phone.open(file.as_uri())
        phone.until("document.documentElement.dataset.drawn")
        assert phone.wide() == 390


@pytest.mark.parametrize(
    ("zone", "limits", "tone"),
    [
        ("B", None, "good"),
        ("C", None, "warn"),
        ("fine", {"fine": 9.5}, "good"),
        ("bad", {"fine": 9.5}, "warn"),
        ("C", {"A": 6.0, "B": 9.0, "C": 12.0, "D": 15.0}, "warn"),
        ("E", {"A": 6.0, "B": 9.0, "C": 12.0, "D": 15.0}, "warn"),
    ],
)
def test_the_page_is_as_calm_as_the_rig_s_own_zones(zone, limits, tone):
    checks = history(0.0, 6)
    document = {**checks[-1].document, "zone": zone} | ({} if limits is None else {"zone_limits_db": limits})
    assert f'<p class="lead {tone}">' in health_page(document, [])
