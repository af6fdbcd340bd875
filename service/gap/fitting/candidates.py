"""Explanations fitted beside the datasheet's uncertain values: each from its starts, all of them side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import TracebackType
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from service.gap import processes
from service.gap.fitting.evidence import occam
from service.gap.fitting.fit import Problem
from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground, Values
from service.gap.fitting.stage import COARSE, EXACT, MIDDLE, Stage
from service.gap.fitting.unknowns import BY_SPEED, Unknowns, asleep, slow_to_compute
from service.pool import Workers, workers
from sim.effects import CATALOGUE
from sim.errors import AmbError

Real = NDArray[np.float64]
One = TypeVar("One")
Other = TypeVar("Other")


KEPT_BEGINNINGS = 2
"""Beginnings that go on after each rough stage of a fit."""
LAW_ERROR = 0.01
"""Relative error of a parameter that no data remove: two programs' laws of one effect agree no better (loop delays of
an independent program are found 0.25 us short)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One fitted explanation: no effect, one, or several."""

    effects: tuple[str, ...]
    fit: Fit
    occam: float
    """log of the share of the prior that the data leave"""
    standard_deviations: tuple[dict[str, float], ...]
    given: frozenset[tuple[str, str]] = frozenset()
    """(effect, parameter) that no fit has found: what the others are stated over"""


@dataclass(frozen=True)
class Task:
    """What a worker needs to fit one explanation."""

    ground: Ground
    effects: tuple[str, ...]
    starts: tuple[tuple[Values, ...], ...]
    """Alternative starting values, one mapping per effect each."""
    theta: Real
    """(k,) deviations to start from"""
    stages: tuple[Stage, ...] = (COARSE, MIDDLE, EXACT)
    held: Candidate | None = None
    """An explanation whose nonlinear effects stay as fitted: their force hardly depends on what is fitted beside
    them, and is costly to compute."""
    occam_alone: float = 0.0
    """Occam factor of the plain twin, which both parts of such a sum hold."""
    plain: frozenset[tuple[str, str]] = frozenset()
    """(effect, parameter) that stay where their law is the plainest."""


def fit_task(task: Task) -> Candidate:
    """Fit one explanation from each of its starts, and keep the best."""
    if task.held is None:
        return _fitted(task)
    held = task.held
    fixed = {name: v for name, v in zip(held.effects, held.fit.values, strict=True) if slow_to_compute(name)}
    rest = [k for k, name in enumerate(task.effects) if name not in fixed]
    free = replace(
        task,
        ground=replace(task.ground, found=(*task.ground.found, *fixed.items())),
        effects=tuple(task.effects[k] for k in rest),
        starts=tuple(tuple(start[k] for k in rest) for start in task.starts),
        held=None,
    )
    c = _fitted(free)
    values = {**fixed, **dict(zip(c.effects, c.fit.values, strict=True))}
    spread = {
        **dict(zip(held.effects, held.standard_deviations, strict=True)),
        **dict(zip(c.effects, c.standard_deviations, strict=True)),
    }
    ends = {end: which for end, which in held.fit.ends.items() if end[0] in fixed} | dict(c.fit.ends)
    fit = replace(c.fit, effects=task.effects, values=tuple(dict(values[name]) for name in task.effects), ends=ends)
    occam_factor = c.occam + held.occam - task.occam_alone
    return Candidate(task.effects, fit, occam_factor, tuple(spread[name] for name in task.effects))


def _fitted(task: Task) -> Candidate:
    dormant = frozenset.intersection(*(asleep(task.effects, values) for values in task.starts))
    if len({o.speed_rad_s for o in task.ground.observations}) > 1:
        dormant -= BY_SPEED
    problem = Problem(task.ground, [CATALOGUE[name] for name in task.effects], task.plain | dormant)
    unknowns, rough = problem.unknowns, [s for s in task.stages if s.closed]
    begun = [np.concatenate([task.theta[unknowns.active], unknowns.scaled(values)]) for values in task.starts]
    straight = _straight(problem, begun) if problem.model.nonlinear and rough and len(begun) > 1 else []
    for stage in rough:
        begun = _best_of(problem, begun, stage)
    begun += straight
    best: Fit | None = None
    for x in begun:
        try:
            fit = problem.run(x, task.stages[-1])
        except (AmbError, np.linalg.LinAlgError):
            continue
        if best is None or fit.cost < best.cost:
            best = fit
    if best is None:
        raise AmbError(f"no start of {' + '.join(task.effects) or 'the plain twin'} leads to a rig")
    return Candidate(task.effects, best, occam(unknowns, best), _deviations(unknowns, best))


def _best_of(problem: Problem, begun: Sequence[Real], stage: Stage) -> list[Real]:
    """Where a rough stage leads from each beginning, the best ones."""
    led: list[tuple[float, Real]] = []
    for x in begun:
        with suppress(AmbError, np.linalg.LinAlgError):  # this one leads to a rig that cannot be; another may not
            fit = problem.run(x, stage)
            led.append((fit.cost, problem.unknowns.vector(fit)))
    return [x for _, x in sorted(led, key=lambda one: one[0])[:KEPT_BEGINNINGS]]


def _straight(problem: Problem, begun: Sequence[Real]) -> list[Real]:
    """The beginning that leaves least once the datasheet's values have followed it; none where none is possible.

    Rough stages see little of a force that bends little, and may end where it does nothing.
    """
    led: list[tuple[float, Real]] = []
    for x in begun:
        with suppress(AmbError, np.linalg.LinAlgError):
            led.append(problem.settled(x))
    return [x for _, x in sorted(led, key=lambda one: one[0])[:1]]


def _deviations(unknowns: Unknowns, fit: Fit) -> tuple[dict[str, float], ...]:
    """Standard deviation of each effect parameter: the data's, widened where more than noise is left, and the law's.

    A strength that is fitted by its logarithm counts in its own unit here: near nothing its logarithm moves nothing,
    and would seem to leave no room for another parameter that trades against it.
    """
    k, own = unknowns.n_nuisance, unknowns.own
    at = slice(k, k + len(own))
    value = np.array([fit.values[which][p.name] for which, p in own], dtype=float)
    logarithmic = np.array([p.scale == "log" for _, p in own], dtype=bool)
    strength = np.array([p.strength for _, p in own], dtype=bool)
    ranges = np.array([p.high - p.low for _, p in own], dtype=float)
    unit = np.where(logarithmic & strength, value, 1.0)  # of the fit's, in the parameter's own or its logarithm's
    width = np.where(logarithmic & strength, ranges, (unknowns.high - unknowns.low)[: len(own)])
    prior, per = unknowns.prior.copy(), np.ones(len(unknowns.prior))
    prior[at, at], per[at] = np.diag(12.0 / np.maximum(width, 1e-12) ** 2), 1.0 / unit
    covariance = np.linalg.inv(fit.curvature * np.outer(per, per) + prior)
    widened = max(1.0, fit.chi_square / fit.n_residuals)
    sd = np.sqrt(np.maximum(np.diag(covariance)[at], 0) * widened) * unknowns.scale[: len(own)]
    sd = np.hypot(np.where(logarithmic & ~strength, value * sd, sd), LAW_ERROR * np.abs(value))
    out: list[dict[str, float]] = [{} for _ in unknowns.effects]
    for (which, p), s in zip(own, sd, strict=True):
        out[which][p.name] = float(s)
    return tuple(out)


class Fitter:
    """Runs fits, on several processes where ``jobs`` says so; ``fitted`` is called after each."""

    def __init__(self, jobs: int = 1, fitted: Callable[[], None] = lambda: None) -> None:
        self._fitted = fitted
        self.lost: set[tuple[str, ...]] = set()
        """explanations that no start led to a rig for"""
        self._pool: Workers | None = None
        if jobs > 1:
            processes.load()
            self._pool = workers(jobs)

    def __enter__(self) -> Fitter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool:
            self._pool.__exit__(kind, error, trace)

    def run(self, tasks: Iterable[Task]) -> list[Candidate]:
        """Fit all; a candidate that no start leads to a rig for is left out, and named in `lost`."""
        return [c for c in self.each(tasks) if c is not None]

    def each(self, tasks: Iterable[Task]) -> list[Candidate | None]:
        """The same with a None in the place of what is lost."""
        tasks = list(tasks)
        # the longest first, so that none is waited for alone
        order = sorted(range(len(tasks)), key=lambda k: -_labour(tasks[k]))
        mapped = self._mapped([tasks[k] for k in order])
        found: dict[int, Candidate | None] = {}
        for k in order:
            found[k] = next(mapped)
            self._fitted()
        self.lost |= {t.effects for k, t in enumerate(tasks) if found[k] is None}
        return [found[k] for k in range(len(tasks))]

    def over(self, function: Callable[[One], Other], ones: Iterable[One]) -> Iterator[Other]:
        """A pure function of each, on the same processes, which begin at once; without them as it is asked for."""
        return iter(self._pool.map(function, ones)) if self._pool else map(function, ones)

    def _mapped(self, tasks: Sequence[Task]) -> Iterator[Candidate | None]:
        # Fits of the controller take no longer than the way to another process.
        if self._pool and any(t.ground.part.path != "controller" for t in tasks):
            return iter(self._pool.map(_quietly, tasks))
        return map(_quietly, tasks)


def _labour(task: Task) -> int:
    """What a fit costs, roughly."""
    return len(task.starts) * (5 if any(map(slow_to_compute, task.effects)) else 1)


def _quietly(task: Task) -> Candidate | None:
    try:
        return fit_task(task)
    except (AmbError, np.linalg.LinAlgError):  # one fit that fails is told as not weighed
        return None
