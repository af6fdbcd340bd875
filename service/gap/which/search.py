"""Search for the explanation of one part: the plain twin, every single effect, then mixtures by forward selection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT, PROBE
from service.gap.measured.observation import GapError
from service.gap.weighing.ranking import Ranked, noise_levels, ranked
from service.gap.weighing.verdict import MAX_SHARE_LEFT, MAX_SHARE_LEFT_BY_SEVERAL
from service.gap.which.accepted_instead import accepted_instead
from service.gap.which.amplifiers_apart import with_amplifiers_apart
from service.gap.which.beyond_tolerance import beyond_tolerance
from service.gap.which.curvature import CHI_SQUARE_SHOWN, curvatures
from service.gap.which.explained import Explained
from service.gap.which.first_fits import first_fits
from service.gap.which.mixtures import (
    as_fewer,
    extended,
    leaves_to_explain,
    strained,
    with_aliases,
    with_one_more,
    without_superfluous,
)
from service.gap.which.moved_modes import MovedModes, moved_modes
from service.gap.which.one_more_effect import residuals, rough_stages
from service.gap.which.optional_parameters import (
    from_the_datasheet,
    on_modes_that_split,
    on_stops_off_centre,
    softer_in_one_plane,
    with_an_added_filter,
    with_optional_parameters,
    with_plays_of_uneven_density,
    with_the_lag_of_the_displacement,
)
from service.gap.which.plainest_law import plainer_law, weighed_plainly
from service.gap.which.refits import (
    best_of_each,
    better_without_one_effect,
    cost,
    differ_by_alias,
    refitted,
    refitted_from_best,
)
from service.gap.which.uneven_effects import on_one_side, with_uneven_effects
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

LARGEST_MIXTURE = 3
"""Largest mixture within one part."""
SAME_MINIMUM_SHARE = 0.05
"""Share of the gap up to which a fit from a solution on fewer sweeps is taken to be in the same minimum."""


def plain_twin(
    fitter: Fitter, ground: Ground, before: Explained | None = None
) -> tuple[Candidate, tuple[Complex, ...]]:
    """The plain twin, the part's nuisance values refitted, and its weighted residuals, (P, H, n) per sweep.

    ``before`` is the result on fewer sweeps.

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
        The result of `plain_twin`, where it is known.
    most
        Effects of the largest mixture.
    before
        The result on fewer sweeps, whose solutions are further starts.
    """
    null, plain = plain_fit or plain_twin(fitter, ground)
    search = _Search(fitter, ground, null, plain)
    elsewhere = fitter.beside(partial(moved_modes, ground, null))
    search.single_effects(before)
    if most > 1 and not search.curved() and not search.modes_are(elsewhere()):
        search.add_wider_laws(search.found)
        search.add_mixtures(most)
    search.add_lag_of_displacement()
    order = beyond_tolerance(fitter, ground, weighed_plainly(fitter, ground, search.order), most)
    fitted = Explained(ground, tuple(order), search.plain, residuals(ground, order[0].candidate))
    order = accepted_instead(order, fitted.remaining)
    # the simpler law's chi-square differs so little that evidence and shares are kept
    order[0] = replace(order[0], candidate=plainer_law(fitter, ground, order[0].candidate))
    return Explained(
        ground, tuple(order), search.plain, residuals(ground, order[0].candidate), moved=search.moved_modes
    )


@dataclass
class _Search:
    """State of the search in one part: explanations fitted so far, and their order."""

    fitter: Fitter
    ground: Ground
    null: Candidate
    """the plain twin"""
    plain: tuple[Complex, ...]
    """its weighted residuals, (P, H, n) per sweep"""
    found: list[Candidate] = field(default_factory=list)
    order: list[Ranked] = field(default_factory=list)
    """candidates found and the plain twin, by falling evidence"""
    widest: Candidate | None = None
    """the best mixture once its wider laws had been looked for"""
    moved_modes: MovedModes | None = None
    """the twin with modes of the datasheet elsewhere, where that explains as much as single effects do"""

    def single_effects(self, before: Explained | None) -> None:
        """Fit every effect of the part alone; ``before`` is the result on fewer sweeps."""
        continued = [] if before is None else self.fitter.run(_continued(self.ground, before))
        done = {c.effects[0] for c in continued if _in_same_minimum(c, self.null)}
        others = [name for name in self.ground.part.effects if name not in done]
        first = first_fits(self.fitter, self.ground, (self.null, self.plain), others, before, continued)
        probed = _cheapest_of_each([*first, *continued])
        found = refitted(self.fitter, self.ground, self.null, probed)
        if better_null := better_without_one_effect(
            self.fitter, self.ground, self.null, min(found, key=cost, default=self.null)
        ):
            self.null, self.plain = better_null[0], residuals(self.ground, better_null[0])
            found = refitted(self.fitter, self.ground, self.null, found)
        self.found = refitted_from_best(self.fitter, self.ground, found)
        self.order = ranked(self.null, self.found)

    def curved(self) -> bool:
        """Whether a curved characteristic explains most of the gap and more than any effect: no mixtures then.

        They would only approximate it.
        """
        explained = max((c.explained for c in curvatures(self.ground, self.null, self.plain)), default=0.0)
        if explained < CHI_SQUARE_SHOWN:
            return False
        excess = cost(self.null) - sum(noise_levels(self.null, [r.candidate for r in self.order]))
        by_effects = cost(self.null) - min(cost(r.candidate) for r in self.order)
        return explained > max(by_effects, (1 - MAX_SHARE_LEFT) * excess)

    def modes_are(self, elsewhere: MovedModes | None) -> bool:
        """Whether the datasheet's modes at other frequencies explain most of the gap, and as much as any effect does.

        No mixtures then: they would put modes beside those that are in the wrong place.
        """
        noise = sum(noise_levels(self.null, [r.candidate for r in self.order]))
        excess = cost(self.null) - noise
        if elsewhere is None:
            return False
        most_left = cost(self.null) - (1 - MAX_SHARE_LEFT) * excess
        if cost(elsewhere.candidate) > min(most_left, *(cost(r.candidate) for r in self.order)):
            return False
        self.moved_modes = elsewhere
        return True

    def add_wider_laws(self, of: Sequence[Candidate]) -> None:
        """Add wider laws of some of the explanations, where the best one leaves too much.

        Effects that differ from axis to axis, and laws with their dormant parameters.
        """
        best = self.order[0].candidate
        needed = leaves_to_explain(self.ground, self.order[0]) or leaves_much(self.null, self.order)
        # An alias of the best explanation is always compared with it by all of its law. The best one's own may be all
        # that is missing where the datasheet's values make up for it, and nothing is left.
        makes_up = strained(self.order[0])
        wider = [c for c in of if needed or differ_by_alias(c, best) or (makes_up and c is best)]
        woken = with_optional_parameters(self.fitter, self.ground, wider)
        woken += self.fitter.run(softer_in_one_plane(self.ground, self.null, self.plain, wider))
        woken += self.fitter.run(on_modes_that_split(self.ground, wider)) if needed else []
        woken += self.fitter.run(on_stops_off_centre(self.ground, self.null, self.plain, wider)) if needed else []
        uneven = with_uneven_effects(self.fitter, self.ground, self.null, of) if needed else []
        self._add([*uneven, *woken])
        if best not in wider and differ_by_alias(best, self.order[0].candidate):  # its alias leads by a wider law alone
            self._add(with_optional_parameters(self.fitter, self.ground, [best]))
        if rivals := [c for c in woken if differ_by_alias(c, self.order[0].candidate)]:
            self._add(with_uneven_effects(self.fitter, self.ground, self.null, rivals))
        if needed and leaves_to_explain(self.ground, self.order[0]):
            woken += self.fitter.run(from_the_datasheet(self.ground, wider))
            # one axis alone may need all of the law, of which an even effect explains too little to be worth its price
            uneven = with_uneven_effects(self.fitter, self.ground, self.null, woken)
            # filters that the datasheet knows are tuned otherwise sooner than there is one more
            own = [*with_plays_of_uneven_density(self.ground, wider)]
            own += [*with_an_added_filter(self.ground, self.null, wider), *with_amplifiers_apart(self.ground, wider)]
            own += [*on_one_side(self.ground, self.order[0].candidate)]
            self._add([*uneven, *woken, *self.fitter.run(own)])

    def add_lag_of_displacement(self) -> None:
        """Add the law of eddy currents in the flux of a moving rotor, too, where the best explanation names them."""
        best = self.order[0].candidate
        self._add(self.fitter.run(with_the_lag_of_the_displacement(self.ground, best)))

    def _add(self, more: Sequence[Candidate]) -> None:
        """Add explanations of effects that are known already, where they are better."""
        if more:
            self.found = refitted_from_best(self.fitter, self.ground, best_of_each(self.null, [*self.found, *more]))
            self.order = without_superfluous(ranked(self.null, self.found))

    def add_mixtures(self, most: int) -> None:
        """Add mixtures of up to ``most`` effects by forward selection, and what the best one may be instead.

        That has an alias in the place of an effect, or is one effect that includes two.
        """
        fewer = next(r for r in self.order if r.candidate is self.null)
        for size in range(1, most):
            self.widen_mixture()  # all of the laws of two before a third effect
            extension = extended(self.ground, self.order, fewer, size)
            if extension is None:
                break
            fewer = extension.base
            self.found = with_one_more(self.fitter, self.ground, self.order, extension, self.found)
            self.order = without_superfluous(ranked(self.null, self.found))
        best = self.order[0].candidate
        if len(best.effects) > 1:  # also where the last mixture was not extended, as it leaves nothing
            more = with_aliases(self.fitter, self.ground, best, self.found)
            more += as_fewer(self.fitter, self.ground, best)
            self.found = best_of_each(self.null, [*self.found, *more])
            self.order = without_superfluous(ranked(self.null, self.found))
        self.widen_mixture()

    def widen_mixture(self) -> None:
        """Add wider laws of the best explanation's effects, where it is a mixture whose laws are not known as wide."""
        best = self.order[0].candidate
        if len(best.effects) > 1 and best is not self.widest:
            self.add_wider_laws([best])
            self.widest = self.order[0].candidate


def _continued(ground: Ground, before: Explained) -> Iterable[Task]:
    """Tasks of nonlinear effects from their solutions on fewer sweeps, if they explained most: the minima are narrow.

    An effect that does not fit so is also fitted from its own starts: a louder sweep may show another minimum.
    """
    null = before.null.candidate
    noise = sum(noise_levels(null, [r.candidate for r in before.order]))
    for c in (r.candidate for r in before.order):
        alone = len(c.effects) == 1 and CATALOGUE[c.effects[0]].nonlinear
        if alone and cost(c) - noise < 0.5 * (cost(null) - noise):
            yield Task(ground, c.effects, (c.fit.values,), c.fit.theta, (PROBE,))


def _in_same_minimum(c: Candidate, null: Candidate) -> bool:
    """Whether an explanation leaves next to nothing of the gap."""
    return cost(c) - c.fit.n_residuals < SAME_MINIMUM_SHARE * (cost(null) - c.fit.n_residuals)


def _cheapest_of_each(probed: Sequence[Candidate]) -> list[Candidate]:
    """Of fits of the same effects the one of least cost."""
    cheapest: dict[tuple[str, ...], Candidate] = {}
    for c in probed:
        if c.effects not in cheapest or cost(c) < cost(cheapest[c.effects]):
            cheapest[c.effects] = c
    return list(cheapest.values())


def leaves_much(null: Candidate, order: Sequence[Ranked]) -> bool:
    """Whether the best effects leave much of the gap, though no band shows it as the noise is overestimated."""
    best = order[0]
    left = cost(best.candidate) - sum(noise_levels(null, [r.candidate for r in order]))
    return bool(best.candidate.effects) and best.unexplained > MAX_SHARE_LEFT_BY_SEVERAL and left > CHI_SQUARE_SHOWN
