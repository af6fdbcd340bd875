"""False alarms over a year of checks, simulated: figures that hang together, one baseline for all days."""

import numpy as np
import pytest
from scipy.stats import t as student

from service.health.sequential import CHECKS_A_YEAR, Policy, p_values
from sim.errors import AmbError

FIGURES = 30


def false_alarms(policy: Policy, years: int, baseline_share: float, correlation: float, seed: int) -> np.ndarray:
    """Alarms of each rig in its first year of daily checks on which nothing changed, (years,).

    Every rig has one baseline error for all days; figures of a day share a part of their error. The standard
    deviations that a check reports are themselves estimated, with 300 degrees of freedom.
    """
    rng = np.random.default_rng(seed)
    freedom = 300.0
    limits = np.array([policy.threshold(k, FIGURES, freedom) for k in range(CHECKS_A_YEAR)])
    counts = np.zeros(years)
    for k in range(years):
        baseline = rng.normal(size=FIGURES) * np.sqrt(baseline_share)
        common = rng.normal(size=(CHECKS_A_YEAR, 1)) * np.sqrt(correlation)
        own = rng.normal(size=(CHECKS_A_YEAR, FIGURES)) * np.sqrt(1 - correlation)
        change = baseline + np.sqrt(1 - baseline_share) * (common + own)
        std = np.sqrt(rng.chisquare(freedom, size=(CHECKS_A_YEAR, 1)) / freedom)
        counts[k] = np.sum(np.any(np.abs(change) / std > limits[:, None], axis=1))
    return counts


@pytest.mark.parametrize(("share", "correlation"), [(0.0, 0.0), (0.5, 0.0), (0.1, 0.7), (0.9, 0.3)])
def test_a_year_of_daily_checks_has_at_most_one_false_alarm(share, correlation):
    """The loosest policy that can be asked for: one a year. Half of it is kept back for checks beyond daily ones."""
    counts = false_alarms(Policy(1.0), 300, share, correlation, seed=3)
    assert counts.mean() <= 1.0
    if share < 0.9:  # an alarm that a bad baseline brings repeats daily, so means scatter most there
        assert counts.mean() <= 0.75


def test_by_default_a_rig_has_one_false_alarm_in_five_years_at_most():
    counts = false_alarms(Policy(), 400, 0.2, 0.2, seed=4)
    assert counts.mean() <= 0.2
    assert np.mean(counts > 1) <= 0.02


def test_the_level_is_not_wasted_either():
    """Independent figures and days: Bonferroni's bound is nearly reached, so changes are found as early as allowed."""
    counts = false_alarms(Policy(1.0), 300, 0.0, 0.0, seed=5)
    assert counts.mean() > 0.3


def test_no_cadence_exceeds_the_allowance():
    policy = Policy(0.2)
    spent = FIGURES * sum(policy.level(k, FIGURES) for k in range(100_000))
    assert spent <= 0.2
    assert spent > 0.19


def test_more_figures_and_more_checks_ask_for_larger_changes():
    policy = Policy()
    assert policy.threshold(0, 60, 300) > policy.threshold(0, 30, 300)
    assert policy.threshold(2000, 30, 300) > policy.threshold(300, 30, 300)
    assert policy.threshold(0, 30, 20) > policy.threshold(0, 30, 300)  # heavier tails of few blocks


def test_p_values_are_two_sided_and_students():
    p = p_values([2.0, -2.0, 0.0], [1.0, 1.0, 1.0], 10.0)
    assert p[0] == p[1] == pytest.approx(2 * student.sf(2.0, 10))
    assert p[2] == 1.0


@pytest.mark.parametrize("wrong", [0.0, -1.0, 1.5, float("nan")])
def test_an_allowance_must_be_a_share_of_one_a_year(wrong):
    with pytest.raises(AmbError, match="false alarms"):
        Policy(wrong)
