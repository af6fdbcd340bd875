"""Explanations fitted beside the datasheet's uncertain values, each from several starts, in parallel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
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
from service.gap.fitting.unknowns import BY_SPEED, Unknowns, dormant_at_null, slow_to_compute
from service.pool import Workers, workers
from sim.effects import CATALOGUE
from sim.errors import AmbError

Real = NDArray[np.float64]
Argument = TypeVar("Argument")
Result = TypeVar("Result")


Starts = tuple[tuple[Values, ...], ...]

KEPT_STARTS, SAME_END = 2, 0.01
"""Best vectors that are kept after each rough stage of a fit, if they differ by more than this in some value: in units
of a tolerance, of a parameter's scale, or in nats."""
LAW_ERROR = 0.01
"""Relative error of a parameter that no data remove: two programs' laws of one effect agree no better (loop delays of
an independent program are found 0.25 us short)."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One fitted explanation: no effect, one, or several."""

    effects: tuple[str, ...]
    fit: Fit
    occam: float
    """log Occam factor: posterior over prior volume of the parameters"""
    standard_deviations: tuple[dict[str, float], ...]
    """of each effect's parameters, by name; 0 for one that was not fitted"""
    given: frozenset[tuple[str, str]] = frozenset()
    """(effect, parameter) that was not fitted but stated, as the time over which a drift is stated"""


@dataclass(frozen=True)
class Task:
    """What a worker needs to fit one explanation."""

    ground: Ground
    effects: tuple[str, ...]
    starts: Starts | Callable[[], Starts]
    """Alternative starting values, one mapping per effect each; or what finds them, where they are fitted."""
    theta: Real
    """(k,) deviations to start from"""
    stages: tuple[Stage, ...] = (COARSE, MIDDLE, EXACT)
    frozen: Candidate | None = None
    """An explanation whose nonlinear effects stay as fitted: their force hardly depends on what is fitted beside
    them, and is costly to compute."""
    occam_of_plain: float = 0.0
    """Log Occam factor of the plain twin, which is in that of ``frozen`` and in that of the new fit: it counts once."""
    nulled: frozenset[tuple[str, str]] = frozenset()
    """(effect, parameter) that are not fitted but held at their null, where the law is the simplest."""
    good_start: bool = False
    """Whether a start may be so good, and the effect so faint, that rough stages would only move it away: the best one
    also skips them."""
    most_left: Mapping[Stage, float] = field(default_factory=dict)
    """What some rough stages may leave beyond noise, per residual, for further ones to be worth their time."""
    most_left_by_first: Mapping[Stage, float] = field(default_factory=dict)
    """What they may leave from the first start, which is the best, for the others to be worth theirs."""

    def all_starts(self) -> Starts:
        """The starting values, found now where they are not given."""
        return self.starts() if callable(self.starts) else self.starts


def fit_task(task: Task) -> Candidate:
    """Fit one explanation from each of its starts, and keep the best."""
    starts = task.all_starts()
    return _fit_all(task, starts) if task.frozen is None else _fit_beside(task, starts, task.frozen)


def _fit_beside(task: Task, starts: Starts, frozen: Candidate) -> Candidate:
    """Fit an explanation's effects but for the nonlinear ones of ``frozen``, which stay as they are."""
    fixed = {name: v for name, v in zip(frozen.effects, frozen.fit.values, strict=True) if slow_to_compute(name)}
    rest = [k for k, name in enumerate(task.effects) if name not in fixed]
    free = replace(
        task,
        ground=replace(task.ground, found=(*task.ground.found, *fixed.items())),
        effects=tuple(task.effects[k] for k in rest),
        frozen=None,
    )
    c = _fit_all(free, tuple(tuple(start[k] for k in rest) for start in starts))
    values = {**fixed, **dict(zip(c.effects, c.fit.values, strict=True))}
    deviations = {
        **dict(zip(frozen.effects, frozen.standard_deviations, strict=True)),
        **dict(zip(c.effects, c.standard_deviations, strict=True)),
    }
    ends = {end: which for end, which in frozen.fit.ends.items() if end[0] in fixed} | dict(c.fit.ends)
    fit = replace(c.fit, effects=task.effects, values=tuple(dict(values[name]) for name in task.effects), ends=ends)
    occam_factor = c.occam + frozen.occam - task.occam_of_plain
    return Candidate(task.effects, fit, occam_factor, tuple(deviations[name] for name in task.effects))


def _fit_all(task: Task, starts: Starts) -> Candidate:
    """Fit all effects of an explanation: rough stages sort its starts, the last stage goes on from the best ones."""
    dormant = frozenset.intersection(*(dormant_at_null(task.effects, values) for values in starts))
    if len({o.speed_rad_s for o in task.ground.observations}) > 1:
        dormant -= BY_SPEED
    problem = Problem(task.ground, [CATALOGUE[name] for name in task.effects], task.nulled | dormant)
    unknowns, rough = problem.unknowns, [s for s in task.stages if s.closed]
    first = [np.concatenate([task.theta[unknowns.active], unknowns.scaled(values)]) for values in starts]
    vectors, given_up, first_alone = first, False, False
    for stage in rough:
        ends = _ends_of(problem, vectors[:1], stage)
        first_alone |= bool(ends) and _leaves_more(problem, ends[0], stage, task.most_left_by_first)
        if not first_alone:
            ends = sorted([*ends, *_ends_of(problem, vectors[1:], stage)], key=lambda fit: fit.cost)
        vectors = _apart([unknowns.vector(fit) for fit in ends[:KEPT_STARTS]])
        given_up = bool(ends) and _leaves_more(problem, ends[0], stage, task.most_left)
        if given_up:
            vectors = vectors[:1]
            break
    several = len(first) > 1 and not given_up and not first_alone
    if rough and several and (problem.model.nonlinear or task.good_start):
        vectors += _best_start(problem, first)
    best: Fit | None = None
    for x in vectors:
        try:
            fit = problem.run(x, task.stages[-1])
        except (AmbError, np.linalg.LinAlgError):
            continue
        if best is None or fit.cost < best.cost:
            best = fit
    if best is None:
        raise AmbError(f"no start of {' + '.join(task.effects) or 'the plain twin'} leads to a rig")
    return Candidate(task.effects, best, occam(unknowns, best), _deviations(unknowns, best))


def _ends_of(problem: Problem, vectors: Sequence[Real], stage: Stage) -> list[Fit]:
    """Where a rough stage ends that is run from each vector."""
    ends: list[Fit] = []
    for x in vectors:
        with suppress(AmbError, np.linalg.LinAlgError):  # this one leads to an impossible rig; another may not
            ends.append(problem.run(x, stage))
    return ends


def _leaves_more(problem: Problem, end: Fit, stage: Stage, most_left: Mapping[Stage, float]) -> bool:
    """Whether the fit in which a stage ended leaves more than it may, by stage, beyond noise and per residual."""
    return stage in most_left and problem.left_by(end, stage) > most_left[stage]


def _apart(vectors: Sequence[Real]) -> list[Real]:
    """The vectors without those that are as good as an earlier one: starts often lead to the same minimum."""
    kept: list[Real] = []
    for x in vectors:
        if all(np.abs(x - other).max(initial=0.0) > SAME_END for other in kept):
            kept.append(x)
    return kept


def _best_start(problem: Problem, vectors: Sequence[Real]) -> list[Real]:
    """The start of least cost once the datasheet's values are fitted to it; none where none is possible.

    It skips the rough stages: their floor hides a weakly nonlinear force and a faint resonance, and they may end where
    it has no effect.
    """
    ends: list[tuple[float, Real]] = []
    for x in vectors:
        with suppress(AmbError, np.linalg.LinAlgError):
            ends.append(problem.settled(x))
    return [x for _, x in sorted(ends, key=lambda end: end[0])[:1]]


def _deviations(unknowns: Unknowns, fit: Fit) -> tuple[dict[str, float], ...]:
    """Standard deviation of each effect parameter: the data's, widened by residuals beyond noise, and the law's error.

    A strength that is fitted by its logarithm is linearised in its own unit here: near zero its logarithm moves
    nothing, and would seem to leave no freedom to another parameter that trades against it.
    """
    k, own = unknowns.n_nuisance, unknowns.own
    at = slice(k, k + len(own))
    value = np.array([fit.values[which][p.name] for which, p in own], dtype=float)
    logarithmic = np.array([p.scale == "log" for _, p in own], dtype=bool)
    strength = np.array([p.strength for _, p in own], dtype=bool)
    ranges = np.array([p.high - p.low for _, p in own], dtype=float)
    unit = np.where(logarithmic & strength, value, 1.0)  # of the fit's vector, in the unit of the deviation
    width = np.where(logarithmic & strength, ranges, (unknowns.high - unknowns.low)[: len(own)])
    prior, per = unknowns.prior.copy(), np.ones(len(unknowns.prior))
    prior[at, at], per[at] = np.diag(12.0 / np.maximum(width, 1e-12) ** 2), 1.0 / unit
    covariance = np.linalg.inv(fit.curvature * np.outer(per, per) + prior)
    widened = max(1.0, fit.chi_square / fit.n_residuals)
    sd = np.sqrt(np.maximum(np.diag(covariance)[at], 0) * widened) * unknowns.scale[: len(own)]
    sd = np.hypot(np.where(logarithmic & ~strength, value * sd, sd), LAW_ERROR * np.abs(value))
    sd[width == 0] = 0.0  # held
    out: list[dict[str, float]] = [{} for _ in unknowns.effects]
    for (which, p), s in zip(own, sd, strict=True):
        out[which][p.name] = float(s)
    return tuple(out)


class Fitter:
    """Runs fits, on ``jobs`` processes; ``fitted`` is called after each."""

    def __init__(self, jobs: int = 1, fitted: Callable[[], None] = lambda: None) -> None:
        self._fitted = fitted
        self.lost: set[tuple[str, ...]] = set()
        """explanations that could not be fitted: every start led to an impossible rig"""
        self._pool: Workers | None = None
        if jobs > 1:
            processes.prepared()
            self._pool = workers(jobs)

    def __enter__(self) -> Fitter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool:
            self._pool.__exit__(kind, error, trace)

    def run(self, tasks: Iterable[Task]) -> list[Candidate]:
        """Fit all; what cannot be fitted is left out, and added to `lost`."""
        return [c for c in self.each(tasks) if c is not None]

    def each(self, tasks: Iterable[Task]) -> list[Candidate | None]:
        """The same, task by task, with None for what cannot be fitted.

        Tasks are begun as they come, while others are still made; so long ones should come first (`slow_first`). One
        alone is fitted here, where nothing has to be sent and no process may still have to start.
        """
        effects, pending = [], []
        to_come = iter(tasks)
        first = list(islice(to_come, 2))
        for task in chain(first, to_come):
            effects.append(task.effects)
            pending.append(self._begun(task, here=len(first) == 1))
        found = []
        for result in pending:
            found.append(result())
            self._fitted()
        self.lost |= {e for e, one in zip(effects, found, strict=True) if one is None}
        return found

    def over(self, function: Callable[[Argument], Result], arguments: Iterable[Argument]) -> Iterator[Result]:
        """Results of a pure function on the same processes, which begin at once; with one process, lazily."""
        return iter(self._pool.map(function, arguments)) if self._pool else map(function, arguments)

    def beside(self, function: Callable[[], Result]) -> Callable[[], Result]:
        """What waits for the result of a pure function, which one of the processes begins at once; or what calls it."""
        return self._pool.submit(function).result if self._pool else function

    def _begun(self, task: Task, here: bool) -> Callable[[], Candidate | None]:
        """What waits for the result of a fit; where it is fitted ``here``, or with one process, what fits."""
        # Fits of the controller take no longer than sending them to another process.
        if self._pool and not here and task.ground.part.path != "controller":
            return self._pool.submit(_fitted_or_none, task).result
        return partial(_fitted_or_none, task)


def _fitted_or_none(task: Task) -> Candidate | None:
    try:
        return fit_task(task)
    except (AmbError, np.linalg.LinAlgError):  # the report lists it as not weighed
        return None
