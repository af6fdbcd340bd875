"""What a health check found, as data, as a document and in words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from service.distributions import normal_above
from service.health.law import LawNow
from service.health.monitored import Monitored
from service.health.words import changed, other_law, unexplained
from service.identification.arrays import Real
from service.identification.loop.margins import zone
from sim.datasheet import NOT_KNOWN, source_of

NORMAL_95 = float(normal_above(0.025))


@dataclass(frozen=True)
class FigureChange:
    """One figure then and now."""

    monitored: Monitored
    was: float
    std_was: float
    now: float
    std_now: float
    """Both with what is not known of the shapes' splits left out: it is common to both."""
    p_value: float
    """Probability of a change at least that large where nothing changed."""
    threshold: float
    """Standard deviations of the difference above which a change is an alarm."""
    reproducibility: float = 0.0
    """What two campaigns on one rig may differ by beside their noise, one sigma."""

    @property
    def std_change(self) -> float:
        """Standard deviation of the change: of both campaigns, and of what reproduces no better."""
        return math.hypot(self.std_was, self.std_now, self.reproducibility)

    @property
    def change_percent(self) -> float:
        """Change, percent of the baseline."""
        return 100 * (self.now - self.was) / abs(self.was)

    @property
    def std_percent(self) -> float:
        """Standard deviation of the change, percent."""
        return 100 * self.std_change / abs(self.was)

    @property
    def significance(self) -> float:
        """The change in its standard deviations, with sign.

        Of a sensitivity peak, that of its inverse, the distance of the loop from -1: an error moves that alike however
        near it is, where a peak that grows without bound becomes as uncertain, and would never differ from any other.
        """
        if self.monitored.kind != "margin":
            return (self.now - self.was) / max(self.std_change, 1e-300)
        std = math.hypot(self.std_was / self.was**2, self.std_now / self.now**2, self.reproducibility / self.was**2)
        return (1 / self.was - 1 / self.now) / max(std, 1e-300)

    @property
    def drifted(self) -> bool:
        """Whether chance does not explain it."""
        return abs(self.significance) > self.threshold

    def document(self) -> dict[str, Any]:
        """As JSON."""
        m = self.monitored
        return {
            "plane": m.plane,
            "name": m.name,
            "unit": m.unit,
            "description": m.words,
            "kind": m.kind,
            "now": {"value": self.now, "std": self.std_now},
            "baseline": {"value": self.was, "std": self.std_was},
            "change_percent": self.change_percent,
            "change_std_percent": self.std_percent,
            "significance": self.significance,
            "threshold": self.threshold,
            "p_value": self.p_value,
            "drifted": self.drifted,
        }


@dataclass(frozen=True)
class PlaneHealth:
    """One plane after a check."""

    plane: str
    axes: tuple[str, str]
    changes: tuple[FigureChange, ...]
    measured_peak: tuple[float, float] | None
    measured_above: tuple[float, ...]
    """Largest measured |S| of each axis in which one is above the model's peak beyond doubt."""
    rms_over_sigma: float
    unexplained: bool
    """Whether something acts that neither the model nor any change of its parameters explains."""
    frequency_hz: Real
    left_out: tuple[str, ...]
    laws: tuple[LawNow, LawNow]
    """Of both axes: whether it is the commissioning's."""
    beyond_measured: str
    """Why its margins hang on what lies above the band of the commissioning, in words; "" where they do not."""

    @property
    def sensitivity_peaks(self) -> dict[str, FigureChange]:
        """By axis; empty where another control law ran than the model's loop has."""
        return {c.monitored.name[-1]: c for c in self.changes if c.monitored.kind == "margin"}

    @property
    def other_law(self) -> bool:
        """Whether another control law ran than that of the commissioning, in either axis: margins hang on both."""
        return any(law.differs for law in self.laws)

    def peaks(self, zones: tuple[tuple[str, float], ...]) -> dict[str, dict[str, Any]]:
        """Sensitivity peaks by axis, as JSON: of the model, and the largest measured."""
        found: dict[str, dict[str, Any]] = {}
        for k, axis in enumerate(self.axes):
            c = self.sensitivity_peaks.get(axis[-1])
            found[axis] = {
                "value": None if c is None else c.now,
                "std": None if c is None else c.std_now,
                "interval_95": None if c is None else [c.now - NORMAL_95 * c.std_now, c.now + NORMAL_95 * c.std_now],
                "measured": None if self.measured_peak is None else self.measured_peak[k],
                "zone": NOT_KNOWN if c is None or self.beyond_measured else zone(c.now, zones),
            }
        return found


@dataclass(frozen=True)
class HealthResult:
    """A rig after a check."""

    rig: str
    planes: tuple[PlaneHealth, ...]
    tests_made: int
    false_alarms_per_year: float
    level: float
    zones: tuple[tuple[str, float], ...]
    rig_seconds: float | None
    speed_rad_s: float = 0.0
    baseline_speed_rad_s: float | None = 0.0
    """None where the commissioning's result does not tell."""
    at_other_speed: str = ""
    """What to know where the two differ, in a sentence."""
    without_model: tuple[str, ...] = ()
    """Axes of the rig that the commissioning has no model of, and that are not judged."""
    notes: tuple[str, ...] = ()
    """That the speed is another one, what the model lacks of the twin's effects, what is wrong with the log."""

    @property
    def changes(self) -> tuple[FigureChange, ...]:
        """Of all planes."""
        return tuple(c for p in self.planes for c in p.changes)

    @property
    def drifted(self) -> tuple[str, ...]:
        """Ids of the parameters that changed, the surest first; before them those of axes with another control law.

        The sensitivity peak is no parameter: it follows from them, and counts by itself only where none of them did.
        """
        found = [c for c in self.changes if c.drifted]
        causes = [c for c in found if c.monitored.kind != "margin"] or found
        surest = sorted(causes, key=lambda c: -abs(c.significance))
        names = [f"{p.plane}.controller_{law.axis[-1]}" for p in self.planes for law in p.laws if law.differs]
        names += [c.monitored.id for c in surest]
        return tuple(names + [f"{p.plane}.unexplained" for p in self.planes if p.unexplained])

    @property
    def alarm(self) -> bool:
        """Whether anything drifted."""
        return bool(self.drifted)

    @property
    def peak(self) -> float | None:
        """Largest sensitivity peak of all axes whose loop is known, of the model or measured and above it."""
        known = [p for p in self.planes if not p.other_law]
        modelled = [c.now for p in known for c in p.sensitivity_peaks.values()]
        return max([*modelled, *(m for p in known for m in p.measured_above)], default=None)

    @property
    def zone(self) -> str:
        """Zone of the worst axis, of ISO 14839-3 or of the datasheet's own table.

        Not known where a plane's loop is: its tones alone miss the peak. The last zone is known for all that.
        """
        worst = NOT_KNOWN if self.peak is None else zone(self.peak, self.zones)
        if any(p.beyond_measured for p in self.planes):
            return NOT_KNOWN
        whole = not any(p.other_law for p in self.planes)
        return worst if whole or worst == self.zones[-1][0] else NOT_KNOWN

    def _state(self) -> str:
        """Peak and zone in words."""
        if beyond := next((p.beyond_measured for p in self.planes if p.beyond_measured), ""):
            return f"margins and zone not known: {beyond}"
        if not any(p.other_law for p in self.planes):
            return f"sensitivity peak {self.peak or 0.0:.2f}, zone {self.zone} of {source_of(self.zones)}"
        seen = max((m for p in self.planes for m in p.measured_peak or ()), default=None)
        at_least = "" if seen is None else f"; measured at the tones it is up to {seen:.2f}"
        zone_too = f"zone {self.zone}" if self.zone != NOT_KNOWN else "zone not known"
        return f"sensitivity peak not known in the loop of that controller{at_least}, {zone_too}"

    def sentence(self) -> str:
        """The result in one sentence."""
        by_id = {c.monitored.id: c for c in self.changes}
        told = [
            f"{changed(by_id[d].monitored.words, by_id[d].change_percent)} "
            f"({abs(by_id[d].significance):.0f} standard deviations)"
            if d in by_id
            else unexplained(d[0])
            for d in self.drifted
            if ".controller_" not in d
        ]
        if others := [law.axis for p in self.planes for law in p.laws if law.differs]:
            told.insert(0, other_law(*others))
        more = f" and {len(told) - 3} more" if len(told) > 3 else ""
        blind = f"; {', '.join(self.without_model)} not checked, as no model has them" if self.without_model else ""
        found = f"{'; '.join(told[:3])}{more}" if told else "nothing drifted"
        apart = f"; {self.at_other_speed}" if self.at_other_speed and told else ""
        return f"{self.rig}: {found}{blind}; {self._state()}{apart}"

    def document(self) -> dict[str, Any]:
        """The contents of health.json."""
        return {
            "format": "amb-health-check",
            "version": 1,
            "rig": self.rig,
            "alarm": self.alarm,
            "drifted": list(self.drifted),
            "sentence": self.sentence(),
            "parameters": {c.monitored.id: c.document() for c in self.changes},
            "controller": {law.axis: law.document() for p in self.planes for law in p.laws},
            "axes_without_model": list(self.without_model),
            "sensitivity_peak": {axis: p for plane in self.planes for axis, p in plane.peaks(self.zones).items()},
            "zone": self.zone,
            "zone_limits_db": {name: limit for name, limit in self.zones if math.isfinite(limit)},
            "residuals": {
                p.plane: {"rms_over_sigma": p.rms_over_sigma, "unexplained": p.unexplained} for p in self.planes
            },
            "tests_made": self.tests_made,
            "false_alarms_per_year": self.false_alarms_per_year,
            "level": self.level,
            "rig_seconds": self.rig_seconds,
            "speed_rad_s": self.speed_rad_s,
            "baseline_speed_rad_s": self.baseline_speed_rad_s,
            "frequencies_hz": [float(f) for f in self.planes[0].frequency_hz] if self.planes else [],
            "left_out": [text for p in self.planes for text in p.left_out],
            "notes": list(self.notes),
        }
