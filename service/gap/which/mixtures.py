"""Mixtures of effects in one part of the loop: whether to look for one more, which, and whether all are needed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import PROBE
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.another_rig import at_bound, hopeless
from service.gap.weighing.ranking import CLEAR_CHI_SQUARE, Ranked, noise_levels, ranked, renormalised
from service.gap.weighing.significance import alone_hz, significance
from service.gap.weighing.verdict import MIXTURE_SHARE
from service.gap.which.one_more_effect import beside, residuals, rough_beside
from service.gap.which.optional_parameters import with_all_parameters
from service.gap.which.refits import LOST_COST, best_of_each, contained, cost, refitted, to_the_end
from sim.effects import CATALOGUE, aliases

Real = NDArray[np.float64]

PAIRED = 5
"""Best single effects that are also tried in pairs."""
REMAINS = 4.0
"""Significance of what an explanation leaves from which another effect beside it is looked for."""
STRAINED = 3.0
"""Standard deviations of the datasheet's part of the cost, chi-squared, beyond which it is no chance."""
ANOTHER_LAW = 0.15
"""Share of the gap that another program's law of the same effect may leave."""
HARMONICS_OF_ANOTHER_LAW = 0.05
"""Share of the harmonics that another program's law of a nonlinear effect may leave: one stop that gives some of its
force back late left 1.8 or 2.3 % as one half or the other of a sweep's lines was fitted, and hysteresis took that."""
WHOLE_OF_ANOTHER_LAW = 0.01
"""Share of the whole gap that another law of a nonlinear effect may leave in one group, however large a share of that
group's own it is: the error of a law goes with all that the effect does. Six plays in the place of a band of them left
0.0024 in harmonics that held 0.005, and eddy currents took that."""
HOPEFUL = 0.75
"""Share of what fewer effects leave of a group, fundamental or harmonics of a sweep, that one more must get below for
a further one to be tried: an unknown law gives way to the catalogue in small steps only."""


@dataclass(frozen=True)
class Extension:
    """What one more effect is looked for beside, and which."""

    base: Ranked
    beside: tuple[str, ...]
    pairs: bool
    """whether two others may do in its place"""


def extended(ground: Ground, order: Sequence[Ranked], fewer: Ranked, size: int) -> Extension | None:
    """How the explanation by ``size`` effects is extended by one more; None where that has no prospect.

    ``fewer`` is the explanation by fewer effects that these were looked for beside.
    """
    if hopeless(ground, (r.candidate.fit for r in order)):
        return None
    # Of a large gap one effect may explain half and still be no likelier than none; two may explain it all.
    singles = [r for r in order if r.candidate.effects]
    base = order[0] if size > 1 or not singles else next((r for r in singles if not _strained(r)), singles[0])
    if len(base.candidate.effects) < size:
        return None
    leaves = leaves_something(ground, base)
    more = ground.part.effects if leaves else _explaining_more(base, order)
    # Alone, an effect may explain much by values that the datasheet does not allow; beside another it need not.
    hopeful = [base] if size > 1 else [r for r in order if r.candidate.effects]
    gives_way = any(now < HOPEFUL * was for r in hopeful for now, was in zip(r.shares, fewer.shares, strict=True))
    names = tuple(name for name in ground.part.effects if name in more and name not in base.candidate.effects)
    return Extension(base, names, leaves and size == 1) if names and gives_way else None


def with_one_more(
    fitter: Fitter, ground: Ground, order: Sequence[Ranked], extension: Extension, found: Sequence[Candidate]
) -> list[Candidate]:
    """What was found and the mixtures of one effect more than was extended, the best fit of each."""
    null = next(r.candidate for r in order if not r.candidate.effects)
    larger = refitted(fitter, ground, null, fitter.run(_larger(order, extension, ground)))
    everything = [*found, *larger]
    if larger:
        best = min(larger, key=cost)
        if leaves_something(ground, next(r for r in ranked(null, everything) if r.candidate is best)):
            everything += from_the_other_side(fitter, ground, null, best, everything)
            everything += exchanged(fitter, ground, best, everything)
    return best_of_each(null, [*everything, *contained(fitter, ground, null, *everything)])


def leaves_something(ground: Ground, best: Ranked) -> bool:
    """Whether an explanation leaves more than another program's law of the same effects would."""
    # Of a large gap another law of the same effect may leave a little, but asks for no impossible datasheet.
    if max(best.apart) < MIXTURE_SHARE and not _strained(best) and not _at_bound(best):
        return False
    everywhere = list(zip(residuals(ground, best.candidate), ground.observations, strict=True))
    if any(significance(z, o) > REMAINS for z, o in everywhere):
        return True
    return any(alone_hz(ground.part, z, o) is not None for z, o in everywhere)


def _strained(r: Ranked) -> bool:
    """Whether the datasheet's values are further off than chance allows: they make up for what an effect is not."""
    n = len(r.candidate.fit.active)
    return bool(r.candidate.fit.penalty > n + STRAINED * np.sqrt(2 * n))


def _at_bound(r: Ranked) -> bool:
    """Whether a value of the datasheet is as far off as any may be: by chance, one of forty in one twin of 400."""
    return bool(at_bound(r.candidate.fit).any())


def _explaining_more(base: Ranked, order: Sequence[Ranked]) -> set[str]:
    """Effects that leave less where ``base`` leaves too much, with their aliases: they know a shape that bands blur."""
    left = [(k, chi) for k, (chi, _) in enumerate(base.candidate.fit.groups) if base.shares[k] > MIXTURE_SHARE]
    others = [r.candidate for r in order if not set(r.candidate.effects) <= set(base.candidate.effects)]
    more = {
        name
        for c in others
        if any(chi - c.fit.groups[k][0] > CLEAR_CHI_SQUARE for k, chi in left)
        for name in c.effects
    } - set(base.candidate.effects)
    return more | {alias for name in more for alias in CATALOGUE[name].aliases}


def _larger(order: Sequence[Ranked], extension: Extension, ground: Ground) -> Iterable[Task]:
    """Mixtures of one effect more: those of the base with others, and pairs of good singles."""
    best, null = extension.base.candidate, next(r.candidate for r in order if not r.candidate.effects)
    tried, rough, left = set(), rough_beside(best, ground), residuals(ground, best)
    for name in extension.beside:
        tried.add(frozenset((*best.effects, name)))
        task = beside(name, best, null, left, ground, best.fit.theta, rough)
        yield task
        if (more := with_all_parameters(task)) is not None:
            yield more
    if not extension.pairs:
        return
    singles = [r.candidate for r in order if len(r.candidate.effects) == 1][:PAIRED]
    for a, b in combinations(singles, 2):
        if frozenset((*a.effects, *b.effects)) in tried:
            continue
        yield beside(b.effects[0], a, null, residuals(ground, a), ground, a.fit.theta, rough_beside(a, ground))


def from_the_other_side(
    fitter: Fitter, ground: Ground, null: Candidate, best: Candidate, found: Sequence[Candidate]
) -> list[Candidate]:
    """A mixture that leaves something, each of its effects begun anew beside the others.

    What was found first had explained the gap of both, and may have kept a valley that only this made good.
    """
    fewer = {frozenset(c.effects): c for c in found}
    others = [(name, fewer.get(frozenset(best.effects) - {name})) for name in best.effects[:-1]]  # the last was so
    probed = fitter.run(
        beside(name, rest, null, residuals(ground, rest), ground, best.fit.theta, rough_beside(rest, ground))
        for name, rest in others
        if rest is not None
    )
    better = [c for c in probed if cost(c) < cost(best) + LOST_COST]
    return fitter.run(to_the_end(ground, sorted(better, key=cost)[:1]))


def exchanged(fitter: Fitter, ground: Ground, best: Candidate, found: Sequence[Candidate]) -> list[Candidate]:
    """The mixture ``best``, an alias in the place of one of its effects, where none such does as well.

    Alone the two looked alike and one was taken; beside another effect it may be the other that fits, or either.
    """
    singles = {c.effects[0]: c.fit.values[0] for c in found if len(c.effects) == 1}
    as_well = {frozenset(c.effects) for c in found if cost(c) < cost(best) + 2 * ALIKE_LOG_EVIDENCE}
    probed = fitter.run(
        Task(ground, effects, (values,), best.fit.theta, (PROBE,))
        for k, name in enumerate(best.effects)
        for alias in CATALOGUE[name].aliases
        if alias in singles and alias not in best.effects
        for effects in [(*best.effects[:k], alias, *best.effects[k + 1 :])]
        for values in [(*best.fit.values[:k], singles[alias], *best.fit.values[k + 1 :])]
        if frozenset(effects) not in as_well
    )
    return fitter.run(to_the_end(ground, sorted(probed, key=cost)[:1]))


def worthy(everything: Sequence[Ranked]) -> list[Ranked]:
    """The explanations that need all of their effects, by falling evidence."""
    return renormalised([r for r in everything if worth_it(r, everything)])


def worth_it(mixture: Ranked, order: Sequence[Ranked]) -> bool:
    """Whether all effects of a mixture are needed: whatever fewer explain, somewhere they leave three times as much.

    And more than a little of that. Each of two effects may explain all of what is its own, one the fundamental and one
    the harmonics: no single one explains both.
    """
    size = len(mixture.candidate.effects)
    if size < 2:
        return True
    smaller = [r for r in order if 0 < len(r.candidate.effects) < size]
    if mixture.log_evidence < max(r.log_evidence for r in smaller):
        return False
    effects = mixture.candidate.effects
    alias = any(aliases(a, b) for a, b in combinations(effects, 2))
    left = np.array(mixture.apart)
    # Others explain by what the datasheet does not allow.
    allowed = [r for r in smaller if not _strained(r) and (_at_bound(mixture) or not _at_bound(r))]
    gap = _gap_of_groups(order)
    return all(np.any((np.array(r.apart) > _little(r, alias, gap)) & (left < np.array(r.apart) / 3)) for r in allowed)


def _gap_of_groups(order: Sequence[Ranked]) -> Real:
    """What the plain twin leaves of each of `Fit.groups` beyond noise, chi-square; zeros where it is not there."""
    null = next((r.candidate for r in order if not r.candidate.effects), None)
    if null is None:
        return np.zeros(len(order[0].shares))
    noise = noise_levels(null, [r.candidate for r in order])
    return np.array([max(chi - level, 0.0) for (chi, _), level in zip(null.fit.groups, noise, strict=True)])


def _little(r: Ranked, alias: bool, gap: Real) -> Real:
    """Share of what is told apart that an explanation may leave before another effect is needed, one each.

    Another program's law of an effect is some way off, and an alias would make up for it. But what a linear effect
    leaves at one amplitude and not at the other is no matter of its law. ``gap`` as of `_gap_of_groups`.
    """
    little = np.full(len(r.apart), ANOTHER_LAW if alias else MIXTURE_SHARE)
    nonlinear = any(CATALOGUE[name].nonlinear for name in r.candidate.effects)
    if nonlinear and not alias:
        little[1 : len(r.shares) : 2] = HARMONICS_OF_ANOTHER_LAW
    if nonlinear and alias:
        of_whole = WHOLE_OF_ANOTHER_LAW * gap.sum() / np.maximum(gap, np.finfo(float).tiny)
        little[: len(r.shares)] = np.maximum(little[: len(r.shares)], of_whole)
    if alias and not nonlinear:
        of_sweep = np.array(r.shares)[::2]  # fundamentals
        at_one = of_sweep > 3 * of_sweep.min(initial=np.inf)
        little[: len(r.shares) : 2][at_one] = MIXTURE_SHARE
    return little
