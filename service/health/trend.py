"""How figures went over many checks: series for a plot, and a slope with its significance.

The baseline's error is the same in every check, so it moves a whole series up or down and leaves its slope alone: the
slope is judged by the checks' own scatter, and finds a slow drift before any single check does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from service.distributions import student_above
from service.health.sequential import Policy
from service.identification.zoh import Real

FEWEST = 5
DAY_S = 86_400.0


@dataclass(frozen=True)
class Checked:
    """One check in a history."""

    at: datetime
    document: Mapping[str, Any]
    """``amb-health-check``"""
    id: str = ""


@dataclass(frozen=True)
class Series:
    """One figure over time."""

    name: str
    at: tuple[datetime, ...]
    change_percent: Real
    """(N,) against the baseline."""
    std_percent: Real
    """(N,) of each check alone, without the baseline's error."""
    baseline_std_percent: float
    drifted: tuple[bool, ...]
    slope_percent_per_year: float | None
    slope_std: float | None
    significance: float | None
    """Of the slope, in standard deviations."""
    drifting: bool
    """Whether the slope is beyond chance."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "at": [a.isoformat().replace("+00:00", "Z") for a in self.at],
            "change_percent": self.change_percent.tolist(),
            "std_percent": self.std_percent.tolist(),
            "baseline_std_percent": self.baseline_std_percent,
            "drifted": list(self.drifted),
            "slope_percent_per_year": self.slope_percent_per_year,
            "slope_std_percent_per_year": self.slope_std,
            "slope_significance": self.significance,
            "drifting": self.drifting,
        }


def trend(history: Sequence[Checked], policy: Policy | None = None) -> dict[str, Series]:
    """Series of every figure that the history has, in the order of its first check.

    A slope is tested with every check, so it has a check's share of the allowance of false alarms.
    """
    rule = policy or Policy()
    ordered = sorted(history, key=lambda c: c.at)
    names: dict[str, None] = {}
    for c in ordered:
        names.update(dict.fromkeys(c.document["parameters"]))
    level = rule.level(min(len(ordered), 364), max(len(names), 1))
    return {name: _series(name, [c for c in ordered if name in c.document["parameters"]], level) for name in names}


def _series(name: str, checks: list[Checked], level: float) -> Series:
    figures = [c.document["parameters"][name] for c in checks]
    baseline = figures[-1]["baseline"]
    size = abs(baseline["value"]) or 1.0
    # a rig may be commissioned anew: every check is seen against its own baseline
    change = np.array([float(f["change_percent"]) for f in figures])
    std = np.array([100 * float(f["now"]["std"]) / size for f in figures])
    slope = slope_std = significance = None
    drifting = False
    days = np.array([(c.at - checks[0].at).total_seconds() for c in checks]) / DAY_S
    if len(checks) >= FEWEST and np.ptp(days) > 0:
        slope, slope_std, freedom = _slope(days, change, std)
        significance = slope / slope_std if slope_std > 0 else None
        limit = float(student_above(level / 2, freedom))
        drifting = significance is not None and abs(significance) > limit
        slope, slope_std = 365.25 * slope, 365.25 * slope_std
    return Series(
        name,
        tuple(c.at for c in checks),
        change,
        std,
        100 * float(baseline["std"]) / size,
        tuple(bool(f["drifted"]) for f in figures),
        slope,
        slope_std,
        significance,
        drifting,
    )


def _slope(days: Real, change: Real, std: Real) -> tuple[float, float, int]:
    """Weighted slope per day, its standard deviation (widened where checks scatter more than they say), freedom."""
    weight = 1 / np.maximum(std, 1e-12) ** 2
    centre = np.average(days, weights=weight)
    spread = float(np.sum(weight * (days - centre) ** 2))
    slope = float(np.sum(weight * (days - centre) * change)) / spread
    rest = change - np.average(change, weights=weight) - slope * (days - centre)
    freedom = len(days) - 2
    excess = float(np.sum(weight * rest**2)) / freedom
    return slope, float(np.sqrt(max(excess, 1.0) / spread)), freedom
