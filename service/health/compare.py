"""Now against the commissioning: which figure changed, by how much, and whether chance explains it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.distributions import chi2_above
from service.errors import DocumentError
from service.experiment.data import Experiment
from service.experiment.speeds import alike, changed_speed
from service.experiment.units import must_be_in_si
from service.health.fit import PlaneNow, plane_now
from service.health.law import LawNow, law_now
from service.health.monitored import Kind, PlaneFigures, plane_figures
from service.health.result import FigureChange, HealthResult, PlaneHealth
from service.health.sequential import Policy, p_values
from service.identification.arrays import Real
from service.identification.loop.margins import above, measured_sensitivity
from service.identification.measured.etfe import FrequencyResponse
from service.identification.measured.known import as_identified, computed, led_back
from service.identification.measured.logged import checked
from service.identification.measured.noise import ESTIMATED_WEIGHTS
from service.identification.measured.points import PlanePoints
from service.identification.result.saved import SavedPlane, axes_without_model, saved_planes
from service.identification.statistics.derivatives import central_differences, propagated_std
from sim.datasheet import Datasheet
from sim.errors import AmbError

FORMAT = "amb-commissioning-result"
REPRODUCIBILITY: dict[Kind, float] = {
    "magnet": 2e-4,
    "frequency": 1e-6,
    "damping": 1e-3,
    "amplifier": 3e-4,
    "margin": 1e-3,
}
"""Relative, one sigma: what two campaigns on one rig differ by beside their noise. A transient below a quarter of the
accuracy is let pass at every tone, and a figure that hangs on few tones keeps most of it."""


@dataclass(frozen=True)
class Baseline:
    """What a rig was when it was commissioned: the contents of its result.json."""

    document: Mapping[str, Any]

    def __post_init__(self) -> None:
        found = self.document.get("format")
        if found != FORMAT or self.document.get("version") != 1:
            raise DocumentError(f"a baseline is an {FORMAT} of version 1, not {found!r}; give the rig's result.json")

    @property
    def speed_rad_s(self) -> float | None:
        """At which it was measured; None where an older version wrote the document."""
        told = self.document.get("speed_rad_s")
        return None if told is None else float(told)


def compare(
    baseline: Baseline,
    experiment: Experiment,
    datasheet: Datasheet,
    tests_made: int = 0,
    policy: Policy | None = None,
) -> HealthResult:
    """Compare a short experiment with the commissioning.

    Parameters
    ----------
    baseline, datasheet
        Of the rig.
    experiment
        A check's, or any other whose main sweep excites the planes that were commissioned.
    tests_made
        Checks of this rig in the 365 days before this one; they share the allowance of false alarms.
    policy
        Allowance of false alarms.

    Raises
    ------
    AmbError
        The experiment is of another rig, or excites no plane of the baseline well enough.
    """
    if tuple(experiment.axes) != tuple(datasheet.axes):
        raise AmbError(
            f"the experiment has axes {', '.join(experiment.axes)} and the datasheet {', '.join(datasheet.axes)}; "
            "give the datasheet of the rig that was measured"
        )
    must_be_in_si(experiment, datasheet)
    saved = saved_planes(baseline.document, datasheet)
    twin, notes = as_identified(datasheet, baseline.document)
    log = checked(experiment, twin.datasheet, twin.chain)  # as the commissioning's was
    experiment = led_back(log.experiment, log.chain)
    notes = (*notes, *log.warnings, *changed_speed(experiment))
    controller = (np.array(twin.datasheet.numerator), np.array(twin.datasheet.denominator))
    rule = policy or Policy()
    now = {name: plane_now(s, experiment) for name, s in saved.items()}
    was_at, is_at = baseline.speed_rad_s, float(experiment.main.speed_rad_s)
    if at_other_speed := other_speed(was_at, is_at):
        notes = (at_other_speed, *notes)
    if any(n.points.I is None for n in now.values()):
        notes = (*notes, "coil currents are not logged: the amplifiers are taken for unchanged, ki for what changes")
    without_model = axes_without_model(saved.values())
    if without_model:
        notes = (
            f"the commissioning has no model of {', '.join(without_model)}: whether anything drifted there, and their "
            "zone, are not known; commission every axis",
            *notes,
        )
    figures = {name: plane_figures(s, controller) for name, s in saved.items()}
    # one for what the model does not explain, one for each axis' law
    n_tests = sum(len(f.monitored) + 1 + len(s.axes) for f, s in zip(figures.values(), saved.values(), strict=True))
    level = rule.level(tests_made, n_tests)
    planes = []
    for name, s in saved.items():
        freedom = min(now[name].freedom, s_freedom(baseline.document, name))
        threshold = rule.threshold(tests_made, n_tests, freedom)
        changes = _changes(figures[name], s, now[name], freedom, threshold)
        own = computed(now[name].points, s.model.known.chain)
        laws = law_now(own, controller, twin.datasheet.sample_time_s, level)
        planes.append(_plane(s, now[name], changes, own, controller, laws, level))
    return HealthResult(
        rig=datasheet.name,
        planes=tuple(planes),
        tests_made=tests_made,
        false_alarms_per_year=rule.per_year,
        level=level,
        zones=datasheet.sensitivity_zones_db,
        rig_seconds=experiment.rig_seconds,
        speed_rad_s=is_at,
        baseline_speed_rad_s=was_at,
        at_other_speed=at_other_speed,
        without_model=without_model,
        notes=notes,
    )


def _plane(
    saved: SavedPlane,
    now: PlaneNow,
    changes: tuple[FigureChange, ...],
    points: PlanePoints,
    controller: tuple[Real, Real],
    laws: tuple[LawNow, LawNow],
    level: float,
) -> PlaneHealth:
    """What there is to tell of a plane beside its figures' changes, by the points with u as it was computed.

    Where another law ran the model's peaks are those of no loop: there is none of it.
    """
    measured = measured_sensitivity(points)
    if any(law.differs for law in laws):
        changes = tuple(c for c in changes if c.monitored.kind != "margin")
        beyond = ""
    else:
        beyond = saved.beyond_measured(now.model, controller).peak
    return PlaneHealth(
        plane=saved.plane,
        axes=saved.axes,
        changes=changes,
        measured_peak=_measured_peaks(measured),
        measured_above=_measured_above(measured, changes),
        laws=laws,
        beyond_measured=beyond,
        rms_over_sigma=now.rms,
        unexplained=_unexplained(saved, now, level),
        frequency_hz=np.unique(now.points.omega) / (2 * np.pi),
        left_out=now.points.left_out,
    )


def other_speed(was_at: float | None, is_at: float) -> str:
    """What there is to say of the speeds of commissioning and check, either way round; "" where they are alike."""
    if was_at is None:
        same, then = is_at == 0, "at a speed that its result does not tell"
    else:
        same, then = alike(was_at, is_at), f"at {was_at:.4g} rad/s"
    if same:
        return ""
    return (
        f"checked at {is_at:.4g} rad/s and commissioned {then}: what changed may be the speed's, as gyroscopic "
        "coupling is in neither model; check at the speed of the commissioning, or commission at this one"
    )


def s_freedom(document: Mapping[str, Any], plane: str) -> int:
    """Degrees of freedom of the baseline's standard deviations: those of its residuals, where the document tells."""
    evidence = document["planes"][plane].get("mode_evidence") or []
    chosen = [e for e in evidence if e.get("chosen")]
    return max(int(chosen[0]["data"]) - int(chosen[0]["parameters"]), 30) if chosen else 300


def _changes(
    figures: PlaneFigures, saved: SavedPlane, now: PlaneNow, freedom: int, threshold: float
) -> tuple[FigureChange, ...]:
    """Every figure now and then. Errors of check and baseline are independent: other data, other days."""
    was, is_now = figures.of(saved.model), figures.of(now.model)
    std_was = _std(figures, saved, saved.covariance_from_data)
    std_now, _ = now.uncertainty.std(now.model, figures.beside(now.model))
    found = []
    for k, m in enumerate(figures.monitored):
        floor = REPRODUCIBILITY[m.kind] * abs(float(was[k]))
        one = FigureChange(
            m, float(was[k]), float(std_was[k]), float(is_now[k]), float(std_now[k]), 1.0, threshold, floor
        )
        p = p_values(one.significance, 1.0, freedom)
        found.append(replace(one, p_value=float(p)))
    return tuple(found)


def _std(figures: PlaneFigures, saved: SavedPlane, covariance: Real) -> Real:
    """Standard deviations of the baseline's figures."""
    model, size = saved.model, np.sqrt(np.diag(covariance))
    steps = np.maximum(np.minimum(0.1 * size, 1e-5 * np.abs(model.theta[saved.free])), 1e-12)
    of = figures.beside(model)
    gradient = central_differences(lambda theta: of(model.at(theta)), model.theta, saved.free, steps)
    return propagated_std(gradient, covariance)


def _measured_peaks(measured: FrequencyResponse | None) -> tuple[float, float] | None:
    """Largest measured |S| of both axes; the tones of a check are few, so the true peak may be higher."""
    if measured is None:
        return None
    s = np.abs(measured.value)
    return float(s[:, 0, 0].max()), float(s[:, 1, 1].max())


def _measured_above(measured: FrequencyResponse | None, changes: tuple[FigureChange, ...]) -> tuple[float, ...]:
    """Largest measured |S| of each axis in which one is above the model's peak beyond doubt."""
    if measured is None:
        return ()
    peaks = {c.monitored.name[-1]: c.now for c in changes if c.monitored.kind == "margin"}
    found = (above(measured, "AB".index(axis), peak) for axis, peak in peaks.items())
    return tuple(x for x in found if x is not None)


def _unexplained(saved: SavedPlane, now: PlaneNow, level: float) -> bool:
    """Whether the residuals are larger than the noise, and than they were, beyond what chance explains."""
    usual = max(1.0, saved.rms_over_sigma) ** 2 * ESTIMATED_WEIGHTS
    return bool(now.rms**2 > usual * chi2_above(level, now.freedom) / now.freedom)
