"""The explanations of one part of the loop: the plain twin, every single effect, then mixtures by forward selection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT, PROBE
from service.gap.fitting.unknowns import slow_to_compute
from service.gap.measured.observation import GapError
from service.gap.weighing.ranking import Ranked, noise_levels, ranked
from service.gap.weighing.verdict import MAX_SHARE_LEFT, MAX_SHARE_LEFT_BY_SEVERAL
from service.gap.which.beyond_tolerance import beyond_tolerance
from service.gap.which.curvature import CHI_SQUARE_SHOWN, curvatures
from service.gap.which.explained import Explained
from service.gap.which.mixtures import exchanged, extended, leaves_something, with_one_more, worthy
from service.gap.which.one_more_effect import LOOKED_FOR, beside, residuals, rough_beside, rough_stages
from service.gap.which.optional_parameters import with_optional_parameters
from service.gap.which.plainest_law import plainer_law, weighed_plainly
from service.gap.which.refits import best_of_each, contained, cost, refitted, refitted_from_best, same_twin
from service.gap.which.uneven_effects import with_uneven_effects
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LARGEST_MIXTURE = 3
"""Largest mixture within one part."""
SAME_VALLEY_SHARE = 0.05
"""Share of a gap that an explanation of fewer sweeps may leave of more, to be the same valley for sure."""


def plain_twin(
    fitter: Fitter, ground: Ground, before: Explained | None = None
) -> tuple[Candidate, tuple[Complex, ...]]:
    """The plain twin, the datasheet's values of the part refitted, and what it leaves, (P, H, n) per sweep.

    ``before`` is what was found on fewer sweeps.

    Raises
    ------
    GapError
        None can be fitted.
    """
    if before is None:
        task = Task(ground, (), ((),), ground.theta, (*rough_stages(ground), EXACT))
    else:
        task = Task(ground, (), ((),), before.null.candidate.fit.theta, (EXACT,))
    (null,) = fitter.each([task])
    if null is None:
        raise GapError(
            f"no twin can be fitted to the {ground.part.path}: with no values within four of their tolerances is the "
            "datasheet a rig that can be computed; check its values, those of the controller among them"
        )
    return null, residuals(ground, null)


def explain(
    fitter: Fitter,
    ground: Ground,
    plain_fit: tuple[Candidate, tuple[Complex, ...]] | None = None,
    most: int = LARGEST_MIXTURE,
    before: Explained | None = None,
) -> Explained:
    """Fit the plain twin, every single effect of the part, and mixtures where one effect leaves too much.

    Parameters
    ----------
    plain_fit
        What `plain_twin` returned, where that was asked before.
    most
        Largest mixture to look at.
    before
        What was found on fewer sweeps: effects in proportion to the excitation go on from there, others also.
    """
    null, plain = plain_fit or plain_twin(fitter, ground)
    search = _Search(fitter, ground, null, plain)
    search.single_effects(before)
    if most > 1 and not search.curved():
        search.wider_laws(search.found)
        search.mixtures(most)
    order = beyond_tolerance(fitter, ground, weighed_plainly(fitter, ground, search.order))
    # it leaves so little more that its evidence and shares stand
    order[0] = replace(order[0], candidate=plainer_law(fitter, ground, order[0].candidate))
    return Explained(ground, tuple(order), search.plain, residuals(ground, order[0].candidate))


@dataclass
class _Search:
    """The explanations of one part as far as they are found."""

    fitter: Fitter
    ground: Ground
    null: Candidate
    """the plain twin"""
    plain: tuple[Complex, ...]
    """what it leaves, (P, H, n) per sweep"""
    found: list[Candidate] = field(default_factory=list)
    order: list[Ranked] = field(default_factory=list)
    """those found and the plain twin, by falling evidence"""

    def single_effects(self, before: Explained | None) -> None:
        """Fit every effect of the part alone; ``before`` is what fewer sweeps told."""
        kept = [] if before is None else self.fitter.run(_gone_on_with(self.ground, before))
        done = {c.effects[0] for c in kept if _holds(c, self.null)}
        begun = [name for name in self.ground.part.effects if name not in done]
        found = refitted(
            self.fitter, self.ground, self.null, _least_of_each([*self.fitter.run(self._begun(begun, before)), *kept])
        )
        if plainer := contained(self.fitter, self.ground, self.null, min(found, key=cost, default=self.null)):
            self.null, self.plain = plainer[0], residuals(self.ground, plainer[0])
            found = refitted(self.fitter, self.ground, self.null, found)
        self.found = refitted_from_best(self.fitter, self.ground, found)
        self.order = ranked(self.null, self.found)

    def _begun(self, names: Iterable[str], before: Explained | None) -> Iterable[Task]:
        """A first fit of each effect: on from ``before`` where it answers in proportion, or from its own starts.

        An effect draws the plain twin's values off, a large one as far as their tolerances let it: what is quickly
        computed finds its own way from the datasheet's, and a resonance where hardly anything else is left.
        """
        known = {} if before is None else {r.candidate.effects: r.candidate for r in before.order}
        rough = rough_beside(self.null, self.ground)
        near = rough != rough_stages(self.ground)
        for name in names:
            if (name,) in known and not CATALOGUE[name].nonlinear:
                c = known[name,]
                yield Task(self.ground, (name,), (c.fit.values,), c.fit.theta, (PROBE,))
            else:
                from_plain = near and (slow_to_compute(name) or name in LOOKED_FOR)
                theta = self.null.fit.theta if from_plain else self.ground.theta
                yield beside(name, self.null, self.null, self.plain, self.ground, theta, rough)

    def curved(self) -> bool:
        """Whether a curved characteristic explains most of a part, more than any effect: mixtures would bend to it."""
        explained = max((c.explained for c in curvatures(self.ground, self.null, self.plain)), default=0.0)
        if explained < CHI_SQUARE_SHOWN:
            return False
        excess = cost(self.null) - sum(noise_levels(self.null, [r.candidate for r in self.order]))
        by_effects = cost(self.null) - min(cost(r.candidate) for r in self.order)
        return explained > max(by_effects, (1 - MAX_SHARE_LEFT) * excess)

    def wider_laws(self, of: Sequence[Candidate]) -> None:
        """Add wider laws of some of the explanations, where the best leaves too much.

        Effects that differ from axis to axis, and those that have more of a law than most rigs need.
        """
        best = self.order[0].candidate
        asks = leaves_something(self.ground, self.order[0]) or leaves_much(self.null, self.order)
        # what looks like the best is held against it with all of its law: to be told apart takes both
        wider = [c for c in of if asks or same_twin(c, best)]
        more = [
            *(with_uneven_effects(self.fitter, self.ground, self.null, of) if asks else ()),
            *with_optional_parameters(self.fitter, self.ground, wider),
        ]
        if more:
            self.found = refitted_from_best(self.fitter, self.ground, best_of_each(self.null, [*self.found, *more]))
            self.order = worthy(ranked(self.null, self.found))

    def mixtures(self, most: int) -> None:
        """Add mixtures of up to ``most`` effects by forward selection, and what could stand for one of theirs."""
        fewer = next(r for r in self.order if r.candidate is self.null)
        for size in range(1, most):
            extension = extended(self.ground, self.order, fewer, size)
            if extension is None:
                break
            fewer = extension.base
            self.found = with_one_more(self.fitter, self.ground, self.order, extension, self.found)
            self.order = worthy(ranked(self.null, self.found))
        best = self.order[0].candidate
        if len(best.effects) > 1:  # what else could stand for one of them, where nothing is left too
            self.found = best_of_each(self.null, [*self.found, *exchanged(self.fitter, self.ground, best, self.found)])
            self.order = worthy(ranked(self.null, self.found))
        best = self.order[0].candidate
        if len(best.effects) > 1:
            self.wider_laws([best])


def _gone_on_with(ground: Ground, before: Explained) -> Iterable[Task]:
    """Nonlinear effects that explained most of fewer sweeps, from where they did: their valleys are narrow.

    Where one does not hold, it is begun anew as well: a louder sweep may show that it was another valley.
    """
    null = before.null.candidate
    noise = sum(noise_levels(null, [r.candidate for r in before.order]))
    for c in (r.candidate for r in before.order):
        alone = len(c.effects) == 1 and CATALOGUE[c.effects[0]].nonlinear
        if alone and cost(c) - noise < 0.5 * (cost(null) - noise):
            yield Task(ground, c.effects, (c.fit.values,), c.fit.theta, (PROBE,))


def _holds(c: Candidate, null: Candidate) -> bool:
    """Whether an explanation leaves next to nothing of what the plain twin does."""
    return cost(c) - c.fit.n_residuals < SAME_VALLEY_SHARE * (cost(null) - c.fit.n_residuals)


def _least_of_each(probed: Sequence[Candidate]) -> list[Candidate]:
    """Of fits of the same effects the one that leaves least."""
    least: dict[tuple[str, ...], Candidate] = {}
    for c in probed:
        if c.effects not in least or cost(c) < cost(least[c.effects]):
            least[c.effects] = c
    return list(least.values())


def leaves_much(null: Candidate, order: Sequence[Ranked]) -> bool:
    """Whether the best effects leave much of a gap, though overestimated noise hides it from every band."""
    best = order[0]
    left = cost(best.candidate) - sum(noise_levels(null, [r.candidate for r in order]))
    return bool(best.candidate.effects) and best.unexplained > MAX_SHARE_LEFT_BY_SEVERAL and left > CHI_SQUARE_SHOWN
