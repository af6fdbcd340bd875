"""First fits of the single effects of a part; those that take long last, and no further than they have a prospect."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import COARSE, PROBE, WHOLE_PROBE, Stage
from service.gap.fitting.unknowns import slow_first, slow_to_compute
from service.gap.weighing.another_rig import RESONANCES
from service.gap.weighing.ranking import ranked
from service.gap.which.explained import Explained
from service.gap.which.mixtures import leaves_more_than_law_error
from service.gap.which.one_more_effect import GOOD_START, NARROW_MINIMUM, rough_beside, rough_stages, task_beside
from sim.effects import CATALOGUE
from sim.errors import AmbError

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

OUT_OF_REACH = 0.1
"""Share of the gap that a rough stage of a fit must leave for an effect to be given up, if another one leaves no more
than the error of its law: no further stage will make it the better one."""
FAR_OUT, USELESS = 0.5, 0.95
"""Share that it must leave from an effect's first start, the best one, for the others not to be tried: where another
explains the gap, and where none does and the effect is slow to compute. Where a stage sees the gap, all starts of such
an effect ended within 2 % of each other; of a resonance the first nearly always ends lowest or next to it."""
VISIBLE = 0.2
"""What the coarse stage must leave of the gap without an effect, per residual, for a first start to be useless: of
less, which is 0.45 of the stage's floor, rms, every start leaves what chance has it."""
HIDDEN = 0.1
"""What it may leave of the gap without an effect, per residual, for that stage to be left out where an effect is slow
to compute or has a good start: they begin where it ended, 0.32 of its floor from the data, rms, and the next stage
sorts their starts."""


def first_fits(
    fitter: Fitter,
    ground: Ground,
    plain_fit: tuple[Candidate, tuple[Complex, ...]],
    names: Sequence[str],
    before: Explained | None = None,
    continued: Sequence[Candidate] = (),
) -> list[Candidate]:
    """A first fit of each effect: of a linear one from its solution on fewer sweeps, else from its own starts.

    An effect of the rig biases the plain twin's nuisance values, a large one up to their bounds. So a fit starts from
    the datasheet's values; from the plain twin's where an effect is slow to compute, or a resonance whose start needs
    small residuals, if the gap is small beside the floor of a rough stage, at the plain twin's values or once these are
    fitted with that floor.

    Parameters
    ----------
    plain_fit
        The plain twin and its weighted residuals, (P, H, n) per sweep, as of `service.gap.which.search.plain_twin`.
    names
        Effects of the part to be fitted; one of which no start leads to a possible rig is left out.
    before
        The result on fewer sweeps.
    continued
        Effects that are fitted already, from such a result.
    """
    null, plain = plain_fit
    rough = rough_beside(null, ground)
    near = rough != rough_stages(ground)

    def tasks(some: Iterable[str], limits: Limits, ends: Mapping[Stage, End]) -> Iterable[Task]:
        hidden = COARSE in ends and ends[COARSE].left < HIDDEN
        shown = tuple(stage for stage in rough if stage != COARSE or not hidden)
        for name in slow_first(some):
            if (known := _solved(name, before)) is not None:
                yield Task(ground, (name,), (known.fit.values,), known.fit.theta, (PROBE,))
                continue
            theta, from_plain = ground.theta, slow_to_compute(name) or name in GOOD_START
            if from_plain and (near or hidden):
                theta = null.fit.theta if near else ends[COARSE].theta
            task = task_beside(name, null, null, plain, ground, theta, shown)
            if from_plain:
                task = replace(task, stages=_without_hidden(task, shown))
            yield limits.on(task)

    if not rough:
        return fitter.run(tasks(names, Limits(), {}))
    begun = fitter.beside(partial(ends_of_plain_twin, ground, null, rough))
    quick, resonances, slow = _rounds(names)
    found = fitter.run(tasks(quick, Limits(), {}))
    ends, limits = begun(), Limits()
    for some in (resonances, slow):
        if not limits.most_left:  # what a gap allows is the same for every effect that explains it
            limits = limits_of(ground, null, [*found, *continued], ends)
        found += fitter.run(tasks(some, limits, ends))
    return found


def _without_hidden(task: Task, shown: Collection[Stage]) -> tuple[Stage, ...]:
    """The stages of an effect whose good start, or whose start at the plain twin's values, a rough stage may worsen.

    One whose floor hides what is to be explained would sort the starts by chance. Where all do, a nonlinear effect is
    fitted to its end at once: a few steps from the starts would leave it far from there, and it takes half the time
    that the rough stages do.
    """
    *rough, last = (stage for stage in task.stages if not stage.closed or stage in shown)
    (name,) = task.effects
    if not rough and last == PROBE and slow_to_compute(name) and name not in NARROW_MINIMUM:
        last = WHOLE_PROBE
    return (*rough, last)


@dataclass(frozen=True)
class End:
    """Where a rough stage ends without an effect."""

    left: float
    """what it leaves of the gap, beyond noise and per residual"""
    theta: Real
    """(k,) deviations from the datasheet"""


def ends_of_plain_twin(ground: Ground, null: Candidate, rough: Sequence[Stage]) -> dict[Stage, End]:
    """Where rough stages end that are run from the plain twin ``null``."""
    problem = Problem.of(ground, null.fit)
    x = problem.unknowns.vector(null.fit)
    ends = {}
    for stage in rough:
        with suppress(AmbError, np.linalg.LinAlgError):  # on the way lies a rig that cannot be computed
            fit = problem.run(x, stage)
            ends[stage] = End(problem.left_by(fit, stage), fit.theta)
    return ends


@dataclass(frozen=True)
class Limits:
    """What rough stages may leave of the gap, beyond noise and per residual, for an effect to be fitted further."""

    most_left: Mapping[Stage, float] = field(default_factory=dict)
    """as `Task.most_left`"""
    by_first: Mapping[Stage, float] = field(default_factory=dict)
    """as `Task.most_left_by_first`"""
    by_first_of_slow: Mapping[Stage, float] = field(default_factory=dict)
    """the same of an effect that is slow to compute"""

    def on(self, task: Task) -> Task:
        """A task within these limits."""
        by_first = self.by_first_of_slow if slow_to_compute(task.effects[-1]) else self.by_first
        return replace(task, most_left=self.most_left, most_left_by_first=by_first)


def limits_of(ground: Ground, null: Candidate, found: Sequence[Candidate], ends: Mapping[Stage, End]) -> Limits:
    """The limits of effects that may be better than those ``found``.

    These set limits to any where they explain the gap: where they leave no more than law error. ``null`` is the plain
    twin, ``ends`` are those of `ends_of_plain_twin`.
    """

    def of(share: float) -> dict[Stage, float]:
        return {stage: share * end.left for stage, end in ends.items()}

    order = [r for r in ranked(null, found) if r.candidate is not null]
    best = min(order, key=lambda r: r.unexplained, default=None)
    if best is None or leaves_more_than_law_error(ground, best):
        coarse = ends[COARSE].left if COARSE in ends else 0.0
        return Limits(by_first_of_slow={COARSE: USELESS * coarse} if coarse > VISIBLE else {})
    return Limits(of(OUT_OF_REACH), of(FAR_OUT), of(FAR_OUT))


def _rounds(names: Sequence[str]) -> list[list[str]]:
    """The effects by how long they take to fit: quick ones, those of many local minima, those slow to compute."""
    slow = [name for name in names if slow_to_compute(name)]
    resonances = [name for name in names if name in RESONANCES]
    return [[name for name in names if name not in {*slow, *resonances}], resonances, slow]


def _solved(name: str, before: Explained | None) -> Candidate | None:
    """The solution of a linear effect on fewer sweeps."""
    if before is None or CATALOGUE[name].nonlinear:
        return None
    return next((r.candidate for r in before.order if r.candidate.effects == (name,)), None)
