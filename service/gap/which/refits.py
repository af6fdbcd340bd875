"""Continued fits: probes fitted exactly, again from the plain twin, or from the solution of another explanation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import slow_to_compute
from service.gap.weighing.ranking import ranked
from sim.effects import CATALOGUE, aliases

REFINED = 6
"""Number of the best candidates of a round that are fitted exactly; the others keep the few steps of a probe."""
LOG_EVIDENCE_IN_REACH = 30.0
"""Log evidence behind the best probe up to which another candidate may still win when fitted exactly."""
ALIASES = 2
"""Number of aliases of the best candidate that are fitted exactly, however bad the probe: a comparison needs both."""
CONTINUATIONS = 3
"""Times that a fit which ran out of iterations is continued."""
LOST_COST = 2.0
"""Cost above that of a contained explanation (such as the plain twin) from which a fit has missed its minimum."""


def refitted(fitter: Fitter, ground: Ground, null: Candidate, probed: Sequence[Candidate]) -> list[Candidate]:
    """The probed candidates; those that may win are fitted exactly.

    One of higher cost than the plain twin, which it contains, is fitted again from the plain twin's nuisance values.
    Aliases of those fitted exactly are also fitted from these solutions.
    """
    lost = [c for c in probed if cost(c) > cost(null) + LOST_COST and not any(map(slow_to_compute, c.effects))]
    again = fitter.run(Task(ground, c.effects, (c.fit.values,), null.fit.theta, (EXACT,)) for c in lost)
    probed = [*(c for c in probed if c not in lost), *again]
    order = [r for r in ranked(null, probed) if r.candidate is not null]
    near = [r.candidate for r in order if r.log_evidence > order[0].log_evidence - LOG_EVIDENCE_IN_REACH][:REFINED]
    near += [r.candidate for r in order if r.candidate not in near and differ_by_alias(r.candidate, near[0])][:ALIASES]
    # what explains most may be half of a mixture, and no likelier alone than what explains nothing
    near += [c for c in sorted((r.candidate for r in order), key=cost)[:1] if c not in near]
    refitted = [*fitter.run(exact_tasks(ground, near)), *(r.candidate for r in order if r.candidate not in near)]
    likened = sorted(fitter.run(_from_aliases(ground, refitted[: len(near)], refitted)), key=cost, reverse=True)
    from_aliases = {frozenset(c.effects): c for c in likened}  # of each the cheapest
    best = []
    for c in refitted:
        other = from_aliases.pop(frozenset(c.effects), c)
        best.append(c if cost(c) <= cost(other) else other)
    return [*best, *from_aliases.values()]


def refitted_from_best(fitter: Fitter, ground: Ground, found: Sequence[Candidate]) -> list[Candidate]:
    """What was found, with the fit of least cost continued where it ran out of iterations.

    A strongly nonlinear force law takes many. Not converged, it would let any effect beside it seem to explain more.
    """
    best = min(found, key=cost, default=None)
    for _ in range(CONTINUATIONS):
        if best is None or not best.fit.out_of_steps:
            break
        (again,) = fitter.run(exact_tasks(ground, [best])) or [best]
        if cost(again) > cost(best) - LOST_COST:
            break
        found, best = [again if c is best else c for c in found], again
    return list(found)


def _from_aliases(ground: Ground, solved: Sequence[Candidate], known: Sequence[Candidate]) -> Iterable[Task]:
    """Tasks to fit explanations from the solution of one with an alias in the place of an effect, if that is better.

    A resonance has many local minima, and its aliases (`Effect.likened`) may have found a better one. Where the rig
    still rang at some lines nothing is begun that an alias leaves open, as a housing's translation, which would be put
    there.
    """
    rang = any(o.drifting.any() for o in ground.observations)
    costs = {frozenset(c.effects): cost(c) for c in known}
    tried: set[frozenset[str]] = set()
    for c in sorted(solved, key=cost):
        for k, name in enumerate(c.effects):
            for alias in CATALOGUE[name].aliases:
                likened = CATALOGUE[alias].likened.get(name)
                effects = (*c.effects[:k], alias, *c.effects[k + 1 :])
                these = frozenset(effects)
                if likened is None or alias not in ground.part.effects or len(these) < len(effects) or these in tried:
                    continue
                if costs.get(these, np.inf) <= cost(c):
                    continue
                own_starts = likened(c.fit.values[k])
                if rang and len(own_starts) > 1:
                    own_starts = [own for own in own_starts if not _wakes(alias, own)]
                for own in own_starts:  # apart, as a parameter may sleep in one of them
                    tried.add(these)
                    start = (*c.fit.values[:k], own, *c.fit.values[k + 1 :])
                    yield Task(ground, effects, (start,), c.fit.theta, (EXACT,))


def _wakes(name: str, values: Mapping[str, float]) -> bool:
    """Whether some values of an effect wake dormant parameters of its law."""
    return any(p.dormant and values.get(p.name, p.null) != p.null for p in CATALOGUE[name].parameters)


def better_without_one_effect(fitter: Fitter, ground: Ground, *found: Candidate) -> list[Candidate]:
    """Explanations by one effect less than the best fit, where a fit from its solution is better than the one known.

    If a fit has missed its minimum, any further effect seems to explain the difference.
    """
    best, costs = min(found, key=cost), {frozenset(c.effects): cost(c) for c in found}
    tasks = []
    for without in best.effects:
        kept = [k for k, name in enumerate(best.effects) if name != without]
        values = tuple(best.fit.values[k] for k in kept)
        tasks.append(Task(ground, tuple(best.effects[k] for k in kept), (values,), best.fit.theta, (EXACT,)))
    return [c for c in fitter.run(tasks) if cost(c) < costs.get(frozenset(c.effects), np.inf) - LOST_COST]


def best_of_each(null: Candidate, found: Sequence[Candidate]) -> list[Candidate]:
    """Of explanations by the same effects the one of most evidence; the plain twin ``null`` is not among them.

    It need not be the one of least cost: beyond noise, evidence counts a decrease of chi-square less than the penalty
    of the nuisance values that it took, as it may be the error of a law.
    """
    best: dict[frozenset[str], Candidate] = {}
    for r in ranked(null, found):
        best.setdefault(frozenset(r.candidate.effects), r.candidate)
    return [c for c in best.values() if c.effects]


def exact_tasks(ground: Ground, candidates: Iterable[Candidate]) -> Iterable[Task]:
    """Tasks to fit candidates exactly from their present solutions."""
    return (Task(ground, c.effects, (c.fit.values,), c.fit.theta, (EXACT,)) for c in candidates)


def differ_by_alias(a: Candidate, b: Candidate) -> bool:
    """Whether two explanations differ in one effect only, by an alias."""
    one, other = set(a.effects) - set(b.effects), set(b.effects) - set(a.effects)
    return len(one) == len(other) == 1 and aliases(*one, *other)


def cost(c: Candidate) -> float:
    """Chi-square and penalty, which the fit minimised."""
    return c.fit.cost
