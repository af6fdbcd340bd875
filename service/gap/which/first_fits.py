"""First fits of the single effects of a part; those that take long last, and no further than they have a prospect."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import PROBE, Stage
from service.gap.fitting.unknowns import slow_first, slow_to_compute
from service.gap.weighing.another_rig import RESONANCES
from service.gap.weighing.ranking import ranked
from service.gap.which.explained import Explained
from service.gap.which.mixtures import leaves_more_than_law_error
from service.gap.which.one_more_effect import GOOD_START, rough_beside, rough_stages, task_beside
from sim.effects import CATALOGUE
from sim.errors import AmbError

Complex = NDArray[np.complex128]

OUT_OF_REACH = 0.1
"""Share of the gap that a rough stage of a fit must leave for an effect to be given up, if another one leaves no more
than the error of its law: no further stage will make it the better one."""


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
    small residuals, if the gap is small beside the floor of a rough stage.

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

    def tasks(some: Iterable[str], most_left: Mapping[Stage, float]) -> Iterable[Task]:
        for name in slow_first(some):
            if (known := _solved(name, before)) is not None:
                yield Task(ground, (name,), (known.fit.values,), known.fit.theta, (PROBE,))
            else:
                from_plain = near and (slow_to_compute(name) or name in GOOD_START)
                theta = null.fit.theta if from_plain else ground.theta
                yield replace(task_beside(name, null, null, plain, ground, theta, rough), most_left=most_left)

    if not rough:
        return fitter.run(tasks(names, {}))
    found: list[Candidate] = []
    most_left: Mapping[Stage, float] = {}
    for some in _rounds(names):
        if found and not most_left:  # what a gap allows is the same for every effect that explains it
            most_left = most_left_by_another(ground, null, [*found, *continued], rough)
        found += fitter.run(tasks(some, most_left))
    return found


def most_left_by_another(
    ground: Ground, null: Candidate, found: Sequence[Candidate], rough: Sequence[Stage]
) -> dict[Stage, float]:
    """`Task.most_left` of an effect that may be better than those ``found``; empty where these explain too little.

    They do where they leave more than law error. ``null`` is the plain twin, ``rough`` as of `rough_beside`.
    """
    order = [r for r in ranked(null, found) if r.candidate is not null]
    best = min(order, key=lambda r: r.unexplained, default=None)
    if best is None or leaves_more_than_law_error(ground, best):
        return {}
    problem = Problem.of(ground, null.fit)
    x = problem.unknowns.vector(null.fit)
    left = {}
    for stage in rough:
        with suppress(AmbError, np.linalg.LinAlgError):  # on the way lies a rig that cannot be computed
            left[stage] = OUT_OF_REACH * problem.left_by(problem.run(x, stage), stage)
    return left


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
