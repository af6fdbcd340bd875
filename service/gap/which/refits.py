"""Fits gone on with: to the end, from the plain twin where one was lost, and from where another explanation ended."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import slow_to_compute
from service.gap.weighing.ranking import ranked
from sim.effects import CATALOGUE, aliases

REFINED = 6
"""Best candidates of a round that are fitted to the end; the others stay where a few steps brought them."""
LOG_EVIDENCE_IN_REACH = 30.0
"""Log evidence behind the best probed candidate up to which another may still win when fitted to the end."""
ALIASES = 2
"""Known aliases of the best that are fitted to the end whatever a probe makes of them: to be told apart takes both."""
CONTINUATIONS = 3
"""Times that a fit whose steps ran out goes on."""
LOST_COST = 2.0
"""Cost above the plain twin's from which a probe has not found its valley."""


def refitted(fitter: Fitter, ground: Ground, null: Candidate, probed: Sequence[Candidate]) -> list[Candidate]:
    """The probed candidates, those that may win fitted to the end.

    One that does worse than the plain twin, which it contains, is lost: it begins again at the plain twin.
    """
    lost = [c for c in probed if cost(c) > cost(null) + LOST_COST and not any(map(slow_to_compute, c.effects))]
    again = fitter.run(Task(ground, c.effects, (c.fit.values,), null.fit.theta, (EXACT,)) for c in lost)
    probed = [*(c for c in probed if c not in lost), *again]
    order = [r for r in ranked(null, probed) if r.candidate is not null]
    near = [r.candidate for r in order if r.log_evidence > order[0].log_evidence - LOG_EVIDENCE_IN_REACH][:REFINED]
    near += [r.candidate for r in order if r.candidate not in near and same_twin(r.candidate, near[0])][:ALIASES]
    refitted = [*fitter.run(to_the_end(ground, near)), *(r.candidate for r in order if r.candidate not in near)]
    lent = {frozenset(c.effects): c for c in fitter.run(_lent(ground, refitted[: len(near)], refitted))}
    kept = []
    for c in refitted:
        other = lent.pop(frozenset(c.effects), c)
        kept.append(c if cost(c) <= cost(other) else other)
    return [*kept, *lent.values()]


def refitted_from_best(fitter: Fitter, ground: Ground, found: Sequence[Candidate]) -> list[Candidate]:
    """What was found, the one that leaves least fitted on where its steps ran out: mixtures would seem to explain more.

    A force law that bends much takes many steps; another effect beside it would only go on from there, for minutes.
    """
    best = min(found, key=cost, default=None)
    for _ in range(CONTINUATIONS):
        if best is None or not best.fit.out_of_steps:
            break
        (again,) = fitter.run(to_the_end(ground, [best])) or [best]
        if cost(again) > cost(best) - LOST_COST:
            break
        found, best = [again if c is best else c for c in found], again
    return list(found)


def _lent(ground: Ground, lenders: Sequence[Candidate], known: Sequence[Candidate]) -> Iterable[Task]:
    """Tasks to fit known aliases from where their like ended, where they did worse: a resonance has many valleys."""
    costs = {frozenset(c.effects): cost(c) for c in known}
    tried: set[frozenset[str]] = set()
    for lender in sorted(lenders, key=cost):
        for k, name in enumerate(lender.effects):
            for alias in CATALOGUE[name].aliases:
                likened = CATALOGUE[alias].likened.get(name)
                effects = (*lender.effects[:k], alias, *lender.effects[k + 1 :])
                these = frozenset(effects)
                if likened is None or alias not in ground.part.effects or len(these) < len(effects) or these in tried:
                    continue
                values = likened(lender.fit.values[k])
                if values and costs.get(these, np.inf) > cost(lender):
                    tried.add(these)
                    starts = ((*lender.fit.values[:k], values, *lender.fit.values[k + 1 :]),)
                    yield Task(ground, effects, starts, lender.fit.theta, (EXACT,))


def contained(fitter: Fitter, ground: Ground, *found: Candidate) -> list[Candidate]:
    """The explanations with one effect less than the one that leaves least, where they do better from where that ended.

    A fit that stopped short of its valley leaves what any further effect seems to explain, by going on from there.
    """
    best, costs = min(found, key=cost), {frozenset(c.effects): cost(c) for c in found}
    tasks = []
    for without in best.effects:
        kept = [k for k, name in enumerate(best.effects) if name != without]
        values = tuple(best.fit.values[k] for k in kept)
        tasks.append(Task(ground, tuple(best.effects[k] for k in kept), (values,), best.fit.theta, (EXACT,)))
    return [c for c in fitter.run(tasks) if cost(c) < costs.get(frozenset(c.effects), np.inf) - LOST_COST]


def best_of_each(null: Candidate, found: Sequence[Candidate]) -> list[Candidate]:
    """Of explanations by the same effects the likeliest; there is one plain twin, ``null``, which is not among them.

    Where more than noise is left, that need not be the one that leaves least: what a fit still gains there by pulling
    at the datasheet's values is the misfit of a law, and evidence holds their price against it in full.
    """
    best: dict[frozenset[str], Candidate] = {}
    for r in ranked(null, found):
        best.setdefault(frozenset(r.candidate.effects), r.candidate)
    return [c for c in best.values() if c.effects]


def to_the_end(ground: Ground, candidates: Iterable[Candidate]) -> Iterable[Task]:
    """Tasks to fit candidates exactly from where they are."""
    return (Task(ground, c.effects, (c.fit.values,), c.fit.theta, (EXACT,)) for c in candidates)


def same_twin(a: Candidate, b: Candidate) -> bool:
    """Whether two explanations are the same but for one effect that looks like the other's."""
    one, other = set(a.effects) - set(b.effects), set(b.effects) - set(a.effects)
    return len(one) == len(other) == 1 and aliases(*one, *other)


def cost(c: Candidate) -> float:
    """What the fit minimised: chi-square and the price of the datasheet's values."""
    return c.fit.cost
