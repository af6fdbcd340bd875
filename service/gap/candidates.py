"""Which effect: every candidate of the catalogue fitted beside the datasheet's uncertain values, then pairs.

Starts are found in the data: a resonance at the frequencies where the plain twin fails most, a clearance from
the largest displacement, a slew limit from the largest rate of current.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from service.gap.evidence import occam
from service.gap.fit import COARSE, EXACT, MIDDLE, Fit, Problem, Stage
from service.gap.nuisance import Nuisance
from service.gap.observation import Observation
from service.gap.predict import residual
from sim.effect import Effect
from sim.effects import CATALOGUE
from sim.errors import AmbError
from sim.rig import Rig

Real = NDArray[np.float64]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Candidate:
    """One fitted explanation: no effect, one, or several."""

    effects: tuple[str, ...]
    fit: Fit
    occam: float
    """log of the share of the prior that the data leave"""
    standard_deviations: tuple[dict[str, float], ...]


@dataclass(frozen=True)
class Task:
    """What a worker needs to fit one explanation."""

    nuisance: Nuisance
    observations: tuple[Observation, ...]
    effects: tuple[str, ...]
    starts: tuple[tuple[Values, ...], ...]
    """Alternative starting values, one mapping per effect each."""
    theta: Real
    stages: tuple[Stage, ...] = (COARSE, MIDDLE, EXACT)


def possible(nuisance: Nuisance, observations: Sequence[Observation]) -> list[Effect]:
    """Effects that this rig and these conditions could show, additive ones excepted (`service.gap.additive`)."""
    turning = any(o.speed_rad_s for o in observations)
    n_axes, modes = nuisance.rig.n_axes, nuisance.n_modes
    return [
        e
        for e in CATALOGUE.values()
        if e.path != "additive"
        and e.needs_axes <= n_axes
        and (turning or not e.needs_speed)
        and (modes or e.id not in ("modal_damping", "internal_damping"))
    ]


def peaks_of_failure(rig: Rig, o: Observation, count: int = 2) -> list[float]:
    """Frequencies where a twin leaves most of the displacement unexplained, Hz, largest first."""
    n = rig.n_axes
    z = np.abs(residual(rig, o)[:, o.fundamental, 2 * n :]) ** 2
    total = np.bincount(o.line, weights=np.log1p(z).sum(axis=1), minlength=len(o.frequency_hz))
    per_line = total / np.maximum(np.bincount(o.line, minlength=len(o.frequency_hz)), 1)
    inner = np.r_[False, (per_line[1:-1] >= per_line[:-2]) & (per_line[1:-1] >= per_line[2:]), False]
    inner[[0, -1]] = per_line[[0, -1]] > per_line[[1, -2]]
    order = np.argsort(np.where(inner, -per_line, 0.0))
    return [float(o.frequency_hz[k]) for k in order[:count]]


def starts(effect: Effect, null_rig: Rig, o: Observation) -> list[dict[str, float]]:
    """Starting values of an effect's parameters, several where its answer has several valleys."""
    base = {
        p.name: p.typical if p.scale == "log" or not p.strength else p.null + 0.2 * (p.typical - p.null)
        for p in effect.parameters
    }
    current = np.abs(o.U if o.I is None else o.I)[:, o.fundamental].max(axis=1)
    swing = float(np.abs(o.Y[:, o.fundamental]).max())
    if effect.id in ("support_resonance", "extra_flexible_mode"):
        found = peaks_of_failure(null_rig, o)
        return [{**base, "frequency_hz": f} for f in (*found, base["frequency_hz"])]
    if effect.id == "eddy_currents":
        return [base, {**base, "time_constant_s": 1e-5, "corner_rad_s": 2e4}]
    if effect.id == "touchdown_contact":
        return [{**base, "clearance_m": share * swing} for share in (0.85, 0.5)]
    if effect.id == "amplifier_voltage_limit":
        rate = float((current * 2 * np.pi * o.points_hz).max())
        return [{**base, "slew_inverse_s_per_a": 1 / (share * rate)} for share in (0.9, 0.6)]
    if effect.id == "off_centre_rotor":
        return [{k: sign * v for k, v in base.items()} for sign in (1.0, -1.0)]
    return [base]


def fit_task(task: Task) -> Candidate:
    """Fit one explanation from each of its starts, and keep the best."""
    best: tuple[Problem, Fit] | None = None
    problem = Problem(task.nuisance, task.observations, [CATALOGUE[name] for name in task.effects])
    rough = [s for s in task.stages if s.closed]
    begun: list[tuple[float, Real, Real]] = []
    for values in task.starts:
        theta, e = task.theta, problem.scaled(values)
        cost = np.inf
        try:
            for stage in rough:
                theta, e, fit = problem.run(theta, e, stage)
                cost = fit.chi_square + fit.penalty
        except (AmbError, np.linalg.LinAlgError):
            continue  # this start leads to a rig that cannot be; another may not
        begun.append((cost, theta, e))
    begun.sort(key=lambda b: b[0])
    for _, theta, e in begun[:2]:
        try:
            _, _, fit = problem.run(theta, e, task.stages[-1])
        except (AmbError, np.linalg.LinAlgError):
            continue
        if best is None or fit.chi_square + fit.penalty < best[1].chi_square + best[1].penalty:
            best = problem, fit
    if best is None:
        raise AmbError(f"no start of {' + '.join(task.effects) or 'the plain twin'} leads to a rig")
    problem, fit = best
    return Candidate(task.effects, fit, occam(problem, fit), _deviations(problem, fit))


def _deviations(problem: Problem, fit: Fit) -> tuple[dict[str, float], ...]:
    """Standard deviation of each effect parameter, widened where the fit leaves more than noise."""
    k = len(problem.nuisance)
    width = problem.high - problem.low
    prior = np.concatenate([np.ones(k), 12.0 / np.maximum(width, 1e-12) ** 2])
    covariance = np.linalg.inv(fit.curvature + np.diag(prior))
    widened = max(1.0, fit.chi_square / fit.n_residuals)
    scaled = np.sqrt(np.maximum(np.diag(covariance)[k:], 0) * widened) * problem.scale
    out: list[dict[str, float]] = [{} for _ in problem.effects]
    for (which, p), sd in zip(problem.parameters, scaled, strict=True):
        value = fit.values[which][p.name]
        out[which][p.name] = float(sd * value) if p.scale == "log" else float(sd)
    return tuple(out)


class Fitter:
    """Runs fits, on several processes where ``jobs`` says so."""

    def __init__(self, jobs: int = 1) -> None:
        self._pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) if jobs > 1 else None

    def __enter__(self) -> Fitter:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool:
            self._pool.shutdown()

    def run(self, tasks: Iterable[Task]) -> list[Candidate]:
        """Fit all; a candidate that no start leads to a rig for is left out."""
        mapped = self._pool.map(_quietly, tasks) if self._pool else map(_quietly, tasks)
        return [c for c in mapped if c is not None]


def _quietly(task: Task) -> Candidate | None:
    try:
        return fit_task(task)
    except AmbError:
        return None
