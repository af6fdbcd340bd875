"""How figures went over many checks: series for a plot, and a slope with its significance.

A baseline's error is the same in every check against it, so it moves them all up or down and leaves their slope alone:
the slope is judged by the checks' own scatter, and finds a slow drift before any single check does. A rig that was
commissioned anew has another such error since, and one that is checked at another speed has what gyroscopic coupling
changes: the checks against each baseline at each speed have a level of their own, and all have one slope.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.distributions import student_above
from service.experiment.speeds import alike
from service.health.sequential import Policy
from service.identification.arrays import Real

FEWEST = 5
DAY_S = 86_400.0
YEAR_S = 365 * DAY_S


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
    """Of the newest check's baseline."""
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

    A slope is tested with every check, so its level is that of one. Its false alarms are counted by themselves, with an
    allowance as large as that of the checks: the newest one's, unless a ``policy`` has another.
    """
    ordered = sorted(history, key=lambda c: c.at)
    rule = policy or allowance(ordered)
    names: dict[str, None] = {}
    for c in ordered:
        names.update(dict.fromkeys(c.document["parameters"]))
    of_the_year = sum((ordered[-1].at - c.at).total_seconds() < YEAR_S for c in ordered[:-1])
    level = rule.level(of_the_year, max(len(names), 1))
    speeds = _speeds(ordered)
    found = {}
    for name in names:
        of = [k for k, c in enumerate(ordered) if name in c.document["parameters"]]
        found[name] = _series(name, [ordered[k] for k in of], speeds[of], level)
    return found


def allowance(history: Sequence[Checked]) -> Policy:
    """The allowance of false alarms that the newest check was made with; the usual one where none tells."""
    newest = max(history, key=lambda c: c.at, default=None)
    of_it = None if newest is None else newest.document.get("false_alarms_per_year")
    return Policy() if of_it is None else Policy(float(of_it))


def _speeds(checks: Sequence[Checked]) -> Real:
    """The first speed of each check's like, (N,) rad/s; 0 where an older document does not tell."""
    known: list[float] = []
    out = []
    for c in checks:
        speed = float(c.document.get("speed_rad_s") or 0.0)
        if not any(alike(k, speed) for k in known):
            known.append(speed)
        out.append(next(k for k in known if alike(k, speed)))
    return np.array(out)


def _series(name: str, checks: list[Checked], speeds: Real, level: float) -> Series:
    figures = [c.document["parameters"][name] for c in checks]
    # a rig may be commissioned anew: every check is seen against its own baseline
    size = np.array([abs(float(f["baseline"]["value"])) or 1.0 for f in figures])
    change = np.array([float(f["change_percent"]) for f in figures])
    std = 100 * np.array([float(f["now"]["std"]) for f in figures]) / size
    slope = slope_std = significance = None
    drifting = False
    days = np.array([(c.at - checks[0].at).total_seconds() for c in checks]) / DAY_S
    levels = [
        (f["baseline"]["value"], f["baseline"]["std"], speed) for f, speed in zip(figures, speeds.tolist(), strict=True)
    ]
    of = np.unique(levels, axis=0, return_inverse=True)[1]
    if len(checks) >= FEWEST and (found := _slope(days, change, std, of.ravel())):
        slope, slope_std, freedom = found
        significance = slope / slope_std if slope_std > 0 else None
        limit = float(student_above(level / 2, freedom))
        drifting = significance is not None and abs(significance) > limit
        slope, slope_std = 365.25 * slope, 365.25 * slope_std
    return Series(
        name,
        tuple(c.at for c in checks),
        change,
        std,
        100 * float(figures[-1]["baseline"]["std"]) / float(size[-1]),
        tuple(bool(f["drifted"]) for f in figures),
        slope,
        slope_std,
        significance,
        drifting,
    )


def _slope(days: Real, change: Real, std: Real, baseline: NDArray[np.int64]) -> tuple[float, float, int] | None:
    """Weighted slope per day, its standard deviation (widened where checks scatter more than they say), freedom.

    ``baseline`` (N,) numbers baseline and speed of each check. None where none has checks enough at different times.
    """
    weight = 1 / np.maximum(std, 1e-12) ** 2
    of_each = np.zeros(baseline.max() + 1)
    mean_day, mean_change = of_each.copy(), of_each.copy()
    for mean, x in ((of_each, np.ones(len(days))), (mean_day, days), (mean_change, change)):
        np.add.at(mean, baseline, weight * x)
    since, moved = days - (mean_day / of_each)[baseline], change - (mean_change / of_each)[baseline]
    spread, freedom = float(np.sum(weight * since**2)), len(days) - len(of_each) - 1
    if freedom < FEWEST - 2 or not np.any(np.abs(since) > 1e-9):
        return None
    slope = float(np.sum(weight * since * moved)) / spread
    excess = float(np.sum(weight * (moved - slope * since) ** 2)) / freedom
    return slope, float(np.sqrt(max(excess, 1.0) / spread)), freedom
