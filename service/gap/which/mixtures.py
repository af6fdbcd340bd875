"""Mixtures of effects in one part of the loop: when to add one more effect, which, and whether all are needed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT, PROBE
from service.gap.fitting.unknowns import slow_first
from service.gap.measured.observation import Observation
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.another_rig import RESONANCES, at_bound, hopeless
from service.gap.weighing.ranking import CLEAR_CHI_SQUARE, Ranked, beyond_chance, noise_levels, ranked, renormalised
from service.gap.weighing.significance import alone_hz, significance
from service.gap.weighing.verdict import (
    MAX_SHARE_LEFT_BY_SEVERAL,
    MIXTURE_SHARE,
    WHOLE_OF_ANOTHER_LAW,
    leaves_an_error_of_a_bending_law,
)
from service.gap.which.accepted_instead import DEMOTED
from service.gap.which.one_more_effect import residuals, rough_beside, rough_stages, task_beside
from service.gap.which.optional_parameters import with_all_parameters
from service.gap.which.refits import LOST_COST, best_of_each, better_without_one_effect, cost, exact_tasks, refitted
from sim.effects import CATALOGUE, aliases

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PAIRED = 5
"""Number of the best single effects that are also tried in pairs."""
REMAINS = 4.0
"""Significance of an explanation's residuals from which one more effect is searched for."""
FEW_LINES_SHARE, FEW_LINES_DEVIATES = 0.1, 10.0
"""Share left of a sweep's fundamental, and standard deviations of its chi-square, from which one more effect is
searched for where no band shows that anything is left."""
STRAINED = 3.0
"""Standard deviations of a chi-square variable by which the nuisance values' penalty is beyond chance."""
ANOTHER_LAW = 0.15
"""Share of the gap that another program's law of the same effect may leave."""
HARMONICS_OF_ANOTHER_LAW = 0.05
"""Share of the harmonics that another program's law of a nonlinear effect may leave: a stop whose force lags at release
left 1.8 or 2.3 %, depending on which half of a sweep's lines was fitted, and that was explained as hysteresis."""
HOPEFUL = 0.75
"""Factor by which one more effect must reduce the residuals of a group (fundamental or harmonics of a sweep) for a
further one to be tried: a law outside the catalogue is approximated in many small steps."""
MOST = 0.5
"""Share of what the likeliest single effect leaves at which another one, that leaves no more, is extended instead."""
NEARLY_ALL, MUCH = 0.9, 0.75
"""Share of the gap from which the likeliest leaves nearly all of it, and what `MOST` is then: each of two effects that
couple the planes explains about half of the coupling."""
GROSS = 4e4
"""Chi-square beyond noise of a gross gap, a thousand times the independent values of a law's error."""
OF_ONE_LAW = frozenset(
    {"cross_coupled_stiffness", "gyroscopic_coupling", "magnetic_cross_coupling", "channel_crosstalk"}
)
"""Effects whose law is one matrix, the same in any program. They couple what else is apart, and so make gaps in which a
second effect is a share less than that of another law's error; it is told where it explains what they leave to
noise."""
TRUSTED = 15.0
"""Lead in log evidence by which a second effect is told beside such a one though that leaves no more than noise: values
of the datasheet make up for it, each within its tolerance, and no error of a law can have drawn them there."""
FAR_CLOSER = 0.05
"""Share of what an explanation leaves, up to which one with another effect beside may leave it for both to be told:
what takes up the error of a law takes up a part of it, not nearly all. Of nonlinear effects that holds for aliases:
beside plays of every kind, Bouc-Wen hysteresis, and five laws of saturation none did."""
CLEAR_GAIN = 100.0
"""Cost that an effect must take off beside one that leaves next to nothing of the gap."""
APART = 1.3
"""Ratio of the frequencies of two resonances from which they are two."""


@dataclass(frozen=True)
class Extension:
    """An explanation to be extended by one more effect."""

    base: Ranked
    beside: tuple[str, ...]
    """effects to try beside those of ``base``"""
    pairs: bool
    """whether pairs of other single effects are tried, too"""


def extended(ground: Ground, order: Sequence[Ranked], fewer: Ranked, size: int) -> Extension | None:
    """How the best explanation by ``size`` effects is to be extended by one more; None where that has no prospect.

    ``fewer`` is the explanation that was extended to it.
    """
    if hopeless(ground, (r.candidate.fit for r in order)):
        return None
    # Even where no single effect beats the plain twin: one may explain half of a large gap, and two all of it.
    singles = [r for r in order if r.candidate.effects]
    base = order[0] if size > 1 or not singles else next((r for r in singles if not strained(r)), singles[0])
    if len(base.candidate.effects) < size:
        return None
    if size == 1 and singles:
        # one that explains most of a large gap is no likelier than one that explains nothing, while its values make up
        # for what the second explains
        closest = min(singles, key=lambda r: r.unexplained)
        most = MUCH if base.unexplained > NEARLY_ALL else MOST
        if closest.unexplained < most * base.unexplained:
            base = closest
    leaves = leaves_to_explain(ground, base)
    promising = ground.part.effects if leaves else _explaining_more(base, order)
    # Of single effects any may show a prospect: one that needs implausible nuisance values alone may not need them
    # beside another.
    larger = [base] if size > 1 else [r for r in order if r.candidate.effects]
    progress = any(now < HOPEFUL * was for r in larger for now, was in zip(r.shares, fewer.shares, strict=True))
    names = tuple(name for name in ground.part.effects if name in promising and name not in base.candidate.effects)
    return Extension(base, names, leaves and size == 1) if names and progress else None


def with_one_more(
    fitter: Fitter, ground: Ground, order: Sequence[Ranked], extension: Extension, found: Sequence[Candidate]
) -> list[Candidate]:
    """The best fit of each explanation, of those ``found`` and of mixtures by one effect more."""
    null = next(r.candidate for r in order if not r.candidate.effects)
    larger = refitted(fitter, ground, null, fitter.run(_larger(order, extension, ground)))
    everything = [*found, *larger]
    if larger:
        best = min(larger, key=cost)
        if leaves_to_explain(ground, next(r for r in ranked(null, everything) if r.candidate is best)):
            everything += refitted_in_turn(fitter, ground, null, best, everything)
            everything += with_aliases(fitter, ground, best, everything)
    return best_of_each(null, [*everything, *better_without_one_effect(fitter, ground, null, *everything)])


def leaves_more_than_law_error(ground: Ground, best: Ranked) -> bool:
    """Whether an explanation leaves more than another program's law of the same effects would.

    Such a law leaves a small share of a large gap, without implausible nuisance values.
    """
    little = max(best.apart) < MIXTURE_SHARE and not strained(best) and not _at_bound(best)
    return (not little or _of_one_law(best)) and leaves_more_than_noise(ground, best)


def leaves_to_explain(ground: Ground, best: Ranked) -> bool:
    """Whether so much is left that a wider law or one more effect is looked for.

    Beside effects of the plant all that noise does not make, as they may differ in size by hundreds of times; elsewhere
    what is no error of a law: filters of a controller and limits of amplifiers would follow that error at length.
    """
    of_plant = ground.part.path == "plant" and best.candidate.effects
    return leaves_more_than_noise(ground, best) if of_plant else leaves_more_than_law_error(ground, best)


def leaves_more_than_noise(ground: Ground, best: Ranked) -> bool:
    """Whether something is left of the gap that noise does not make: an error of the law, or one more effect."""
    sweeps = list(zip(residuals(ground, best.candidate), ground.observations, strict=True))
    if any(significance(z, o) > REMAINS for z, o in sweeps):
        return True
    of_sweeps = best.shares[::2]  # of the fundamentals
    if any(
        share > FEW_LINES_SHARE and _few_lines_stand_out(z, o) for share, (z, o) in zip(of_sweeps, sweeps, strict=True)
    ):
        return True
    return any(alone_hz(ground.part, z, o) is not None for z, o in sweeps)


def _few_lines_stand_out(z: Complex, o: Observation) -> bool:
    """Whether residuals of the fundamental are far beyond chance, though no band may show it.

    A narrow resonance is in two lines of a band, each of which counts up to a bound only in `significance`. Points at
    which the rig still rang do not count: no twin predicts them.
    """
    settled = z[~o.drifting, o.fundamental]
    count = 2 * settled.size
    return bool(float((np.abs(settled) ** 2).sum()) - count > FEW_LINES_DEVIATES * np.sqrt(2 * count))


def strained(r: Ranked, borne: float = 0.0) -> bool:
    """Whether the penalty of the nuisance values is beyond chance and ``borne``: they make up for what is missing."""
    n = len(r.candidate.fit.active)
    return bool(r.candidate.fit.penalty > n + STRAINED * np.sqrt(2 * n) + borne)


def _borne(r: Ranked, gap: Real) -> float:
    """Chi-square that nuisance values may bear of the error of a nonlinear effect's law, 0 for linear ones.

    They take up less of it than is left in the data: a law that is off looks like no stiffness. ``gap`` as of
    `_gap_of_groups`.
    """
    if not any(CATALOGUE[name].nonlinear for name in r.candidate.effects):
        return 0.0
    left = float(np.array(r.shares) @ gap)
    return min(left, WHOLE_OF_ANOTHER_LAW * float(gap.sum()))


def _at_bound(r: Ranked) -> bool:
    """Whether a nuisance value is at its bound: by chance one of forty is so in one twin of 400."""
    return bool(at_bound(r.candidate.fit).any())


def _explaining_more(base: Ranked, order: Sequence[Ranked]) -> set[str]:
    """Effects of explanations with clearly less chi-square in a group of which ``base`` leaves much, and their aliases.

    They may fit a shape over frequency that the mean over a band does not show.
    """
    left = [(k, chi) for k, (chi, _) in enumerate(base.candidate.fit.groups) if base.shares[k] > MIXTURE_SHARE]
    others = [r.candidate for r in order if not set(r.candidate.effects) <= set(base.candidate.effects)]
    better = {
        name
        for c in others
        if any(chi - c.fit.groups[k][0] > CLEAR_CHI_SQUARE for k, chi in left)
        for name in c.effects
    } - set(base.candidate.effects)
    return better | {alias for name in better for alias in CATALOGUE[name].aliases}


def _larger(order: Sequence[Ranked], extension: Extension, ground: Ground) -> Iterable[Task]:
    """Tasks of mixtures of one effect more: the base with another effect, and pairs of the best single effects."""
    best, null = extension.base.candidate, next(r.candidate for r in order if not r.candidate.effects)
    tried, rough, left = set(), rough_beside(best, ground), residuals(ground, best)
    for name in slow_first(extension.beside):
        tried.add(frozenset((*best.effects, name)))
        task = task_beside(name, best, null, left, ground, best.fit.theta, rough)
        yield task
        if (with_more_parameters := with_all_parameters(task)) is not None:
            yield with_more_parameters
    # what explains most of the gap by itself, too, is nearer to where both are in its own fit
    for r in order:
        alone = r.candidate
        if len(alone.effects) == 1 and alone.effects[0] in extension.beside and r.unexplained < MOST:
            values, stages = (*best.fit.values, *alone.fit.values), (*rough_stages(ground), PROBE)
            yield Task(ground, (*best.effects, *alone.effects), (values,), alone.fit.theta, stages)
    if not extension.pairs:
        return
    singles = [r.candidate for r in order if len(r.candidate.effects) == 1][:PAIRED]
    for a, b in combinations(singles, 2):
        if frozenset((*a.effects, *b.effects)) in tried:
            continue
        yield task_beside(b.effects[0], a, null, residuals(ground, a), ground, a.fit.theta, rough_beside(a, ground))


def refitted_in_turn(
    fitter: Fitter, ground: Ground, null: Candidate, best: Candidate, found: Sequence[Candidate]
) -> list[Candidate]:
    """The mixture ``best`` fitted again, each of its earlier effects from its own starts beside the others.

    The first effect was fitted alone to a gap that two made, and may be in a local minimum that fits both.
    """
    fewer = {frozenset(c.effects): c for c in found}
    # the last effect was fitted from its own starts
    others = [(name, fewer.get(frozenset(best.effects) - {name})) for name in best.effects[:-1]]
    probed = fitter.run(
        task_beside(name, rest, null, residuals(ground, rest), ground, best.fit.theta, rough_beside(rest, ground))
        for name, rest in others
        if rest is not None
    )
    better = [c for c in probed if cost(c) < cost(best) + LOST_COST]
    return fitter.run(exact_tasks(ground, sorted(better, key=cost)[:1]))


def with_aliases(fitter: Fitter, ground: Ground, best: Candidate, found: Sequence[Candidate]) -> list[Candidate]:
    """The best mixture that has an alias in the place of one effect of ``best``, unless one as good was found.

    Alone both looked alike, and one was chosen; beside another effect only the other may fit, or both.
    """
    singles = {c.effects[0]: c.fit.values[0] for c in found if len(c.effects) == 1}
    as_good = {frozenset(c.effects) for c in found if cost(c) < cost(best) + 2 * ALIKE_LOG_EVIDENCE}
    probed = fitter.run(
        Task(ground, effects, (values,), best.fit.theta, (PROBE,))
        for k, name in enumerate(best.effects)
        for alias in CATALOGUE[name].aliases
        if alias in singles and alias not in best.effects
        for effects in [(*best.effects[:k], alias, *best.effects[k + 1 :])]
        for values in [(*best.fit.values[:k], singles[alias], *best.fit.values[k + 1 :])]
        if frozenset(effects) not in as_good
    )
    return fitter.run(exact_tasks(ground, sorted(probed, key=cost)[:1]))


def as_fewer(fitter: Fitter, ground: Ground, best: Candidate) -> list[Candidate]:
    """A mixture's effects without one that another of them includes (`Effect.includes`), as a housing that rocks."""
    tasks = []
    for k, name in enumerate(best.effects):
        for other, both in CATALOGUE[name].includes.items():
            if other not in best.effects:
                continue
            at = best.effects.index(other)
            values = list(best.fit.values)
            values[k] = dict(both(values[k], values[at]))
            if values[k]:
                kept = [j for j in range(len(values)) if j != at]
                start = tuple(values[j] for j in kept)
                tasks.append(Task(ground, tuple(best.effects[j] for j in kept), (start,), best.fit.theta, (EXACT,)))
    return fitter.run(tasks)


def without_superfluous(everything: Sequence[Ranked]) -> list[Ranked]:
    """The explanations that need all of their effects, by falling evidence."""
    order = beside_a_gross_gap(everything)
    return renormalised([r for r in order if needs_all_effects(r, order)])


def beside_a_gross_gap(order: Sequence[Ranked]) -> list[Ranked]:
    """The order with what leaves nearly all of a gross gap behind what leaves next to nothing of it.

    Evidence takes what is left for the error of a law of a few independent values, and that says next to nothing where
    it is all of a gross gap: two effects that left a hundredth were no likelier than one that left all, as their
    parameters cost more.
    """
    close = [r for r in order if r.candidate.effects and r.unexplained <= MAX_SHARE_LEFT_BY_SEVERAL]
    if not close or _gap_of_groups(order).sum() < GROSS:
        return list(order)
    most = max(r.log_evidence for r in close) - DEMOTED
    lowered = (replace(r, log_evidence=min(r.log_evidence, most)) if r.unexplained > NEARLY_ALL else r for r in order)
    return sorted(lowered, key=lambda r: -r.log_evidence)


def needs_all_effects(mixture: Ranked, order: Sequence[Ranked]) -> bool:
    """Whether every explanation by fewer effects has a group of which it leaves too much, and three times as much.

    Too much is more than another law of its effects would leave (`_tolerated`). One group is enough: of two effects one
    may explain the fundamental and the other the harmonics.
    """
    size = len(mixture.candidate.effects)
    if size < 2:
        return True
    smaller = [r for r in order if 0 < len(r.candidate.effects) < size]
    if mixture.log_evidence < max(r.log_evidence for r in smaller):
        return False
    effects = mixture.candidate.effects
    alias = any(aliases(a, b) for a, b in combinations(effects, 2)) and not _resonances_apart(mixture.candidate)
    left = np.array(mixture.apart)
    gap = _gap_of_groups(order)
    # The others' nuisance values are implausible.
    ended = [_at_bound(r) and not leaves_an_error_of_a_bending_law(r) for r in smaller]
    allowed = [
        r
        for r, at_end in zip(smaller, ended, strict=True)
        if not strained(r, _borne(r, gap)) and (_at_bound(mixture) or not at_end)
    ]
    exact = not alias and _leaves_nothing(mixture)

    def leaves_too_much(r: Ranked) -> bool:
        own, tolerated = np.array(r.apart), _tolerated(r, alias and not _far_closer(mixture, r), gap)
        return bool(np.any((own > tolerated) & (left < own / 3)))

    return all(
        leaves_too_much(r)
        or (not alias and _explains_the_rest(mixture, r))
        or (exact and _of_one_law(r) and (not _leaves_nothing(r) or mixture.log_evidence - r.log_evidence > TRUSTED))
        for r in allowed
    )


def _explains_the_rest(mixture: Ranked, r: Ranked) -> bool:
    """Whether a mixture explains nearly all that ``r`` leaves, however small a share of a gross gap that is.

    An effect that is no alias takes up some of the error of another one's law, and leaves more than a twentieth of it.
    """
    gained = r.candidate.fit.cost - mixture.candidate.fit.cost
    believed = gained > CLEAR_GAIN and mixture.log_evidence - r.log_evidence > TRUSTED
    return believed and mixture.unexplained < FAR_CLOSER * r.unexplained


def _far_closer(mixture: Ranked, r: Ranked) -> bool:
    """Whether nonlinear effects together leave so little of what one of them leaves that its law is not at fault."""
    nonlinear = all(CATALOGUE[name].nonlinear for name in mixture.candidate.effects)
    return nonlinear and mixture.unexplained < FAR_CLOSER * r.unexplained


def _of_one_law(r: Ranked) -> bool:
    """Whether every program has the same law of an explanation's effects: what they leave is something else."""
    return bool(r.candidate.effects) and set(r.candidate.effects) <= OF_ONE_LAW


def _leaves_nothing(r: Ranked) -> bool:
    """Whether an explanation leaves no group of residuals more than noise would by chance."""
    return not beyond_chance(r.candidate, [count for _, count in r.candidate.fit.groups])


def _resonances_apart(c: Candidate) -> bool:
    """Whether two resonances are so far apart that neither is an error of the other's law; aliases are no others."""
    resonances = [k for k, name in enumerate(c.effects) if name in RESONANCES]
    others = [pair for pair in combinations(c.effects, 2) if aliases(*pair) and not set(pair) <= set(RESONANCES)]
    if len(resonances) < 2 or others:
        return False
    low, high = sorted(c.fit.values[k]["frequency_hz"] for k in resonances)
    return high > APART * low


def _gap_of_groups(order: Sequence[Ranked]) -> Real:
    """Excess chi-square of the plain twin in each of `Fit.groups`; zeros where it is not in ``order``."""
    null = next((r.candidate for r in order if not r.candidate.effects), None)
    if null is None:
        return np.zeros(len(order[0].shares))
    noise = noise_levels(null, [r.candidate for r in order])
    return np.array([max(chi - level, 0.0) for (chi, _), level in zip(null.fit.groups, noise, strict=True)])


def _tolerated(r: Ranked, alias: bool, gap: Real) -> Real:
    """Share of each group in `Ranked.apart` that an explanation may leave before another effect is needed.

    It is what another program's law of its effects may leave; with ``alias``, an alias is to be added, which would
    compensate for the error of a law. But what a linear effect leaves at one amplitude and not at the other is no error
    of its law. ``gap`` as of `_gap_of_groups`.
    """
    tolerated = np.full(len(r.apart), ANOTHER_LAW if alias else MIXTURE_SHARE)
    nonlinear = any(CATALOGUE[name].nonlinear for name in r.candidate.effects)
    if nonlinear and not alias:
        tolerated[1 : len(r.shares) : 2] = HARMONICS_OF_ANOTHER_LAW
    if nonlinear and alias:
        of_whole = WHOLE_OF_ANOTHER_LAW * gap.sum() / np.maximum(gap, np.finfo(float).tiny)
        tolerated[: len(r.shares)] = np.maximum(tolerated[: len(r.shares)], of_whole)
    if alias and not nonlinear:
        fundamentals = np.array(r.shares)[::2]
        at_one_amplitude = fundamentals > 3 * fundamentals.min(initial=np.inf)
        tolerated[: len(r.shares) : 2][at_one_amplitude] = MIXTURE_SHARE
    return tolerated
