"""The explanations of one part of the loop: the plain twin, every single effect, then mixtures by forward selection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.gap.candidates import Candidate, Fitter, Task
from service.gap.fit import Problem
from service.gap.observation import Observation
from service.gap.part import Ground, Part
from service.gap.significance import alone_hz, significance
from service.gap.stage import COARSE, EXACT, MIDDLE, PROBE, Stage
from service.gap.starts import largest_rate, starts
from service.gap.unknowns import slow_to_compute
from service.gap.verdict import MIXED, Ranked, ranked, renormalised
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PAIRED = 5
"""Best single effects that are also tried in pairs."""
REFINED = 6
"""Best candidates of a round that are fitted to the end; the others stay where a few steps brought them."""
WITHIN = 30.0
"""Log evidence behind the best probed candidate up to which another may still win when fitted to the end."""
ALIASES = 2
"""Known aliases of the best that are fitted to the end whatever a probe makes of them: to be told apart takes both."""
MOST = 3
"""Largest mixture within one part."""
REMAINS = 4.0
"""Significance of what an explanation leaves from which another effect beside it is looked for."""
LOST = 2.0
"""Cost above the plain twin's from which a probe has not found its valley."""
HOPEFUL = 0.75
"""Share of what fewer effects leave of a group, fundamental or harmonics of a sweep, that one more must get below for
a further one to be tried: an unknown law gives way to the catalogue in small steps only."""
SHARP = ("touchdown_contact",)
"""Effects whose start is good and whose valley is narrow: a rough fit would lose it."""
LOOKED_FOR = ("support_resonance", "extra_flexible_mode")
"""Effects whose start the data give so well that a rough fit may lose it where it hardly sees the effect."""


@dataclass(frozen=True)
class Explained:
    """What the search found in one part."""

    ground: Ground
    order: tuple[Ranked, ...]
    """by falling evidence, the plain twin among them"""
    plain: tuple[Complex, ...]
    """weighted residuals of the plain twin, (P, H, n) per sweep"""
    left: tuple[Complex, ...]
    """the same of the best explanation"""
    elsewhere: tuple[Ranked, ...] = ()
    """by effects of another part, which would explain this one's gap about as well; log evidence on this one's scale"""

    @property
    def part(self) -> Part:
        """The part of the loop."""
        return self.ground.part

    @property
    def null(self) -> Ranked:
        """The plain twin."""
        return next(r for r in self.order if not r.candidate.effects)

    @property
    def significance(self) -> float:
        """Of the gap that the plain twin leaves."""
        return gap_significance(self.plain, self.ground.observations)

    @property
    def remaining(self) -> float:
        """Significance of what the best explanation leaves."""
        return max(significance(z, o) for z, o in zip(self.left, self.ground.observations, strict=True))


def gap_significance(plain: Sequence[Complex], observations: Sequence[Observation]) -> float:
    """Significance of what the plain twin leaves at the excited frequency, over bands and channels."""
    return max(significance(z[:, [o.fundamental]], o, bound=np.inf) for z, o in zip(plain, observations, strict=True))


def plain_twin(
    fitter: Fitter, ground: Ground, before: Explained | None = None
) -> tuple[Candidate, tuple[Complex, ...]]:
    """The plain twin, the datasheet's values of the part refitted, and what it leaves, (P, H, n) per sweep.

    ``before`` is what was found on fewer sweeps.
    """
    if before is None:
        null = fitter.run([Task(ground, (), ((),), ground.theta, (*_rough(ground), EXACT))])[0]
    else:
        null = fitter.run([Task(ground, (), ((),), before.null.candidate.fit.theta, (EXACT,))])[0]
    return null, residuals(ground, null)


def explain(
    fitter: Fitter,
    ground: Ground,
    plain_fit: tuple[Candidate, tuple[Complex, ...]] | None = None,
    most: int = MOST,
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
        What was found on fewer sweeps: effects in proportion to the excitation go on from there.
    """
    null, plain = plain_fit or plain_twin(fitter, ground)
    known = {} if before is None else {c.effects: c for c in (r.candidate for r in before.order)}
    # An effect draws the plain twin's values off, a large one as far as their tolerances let it: what is quickly
    # computed finds its own way from the datasheet's, and a resonance where hardly anything else is left.
    rough = _rough_beside(null, ground)
    near = rough != _rough(ground)

    def theta(name: str) -> Real:
        return null.fit.theta if near and (slow_to_compute(name) or name in LOOKED_FOR) else ground.theta

    probed = fitter.run(
        Task(ground, (name,), (known[name,].fit.values,), known[name,].fit.theta, (PROBE,))
        if (name,) in known and not CATALOGUE[name].nonlinear
        else _with(name, null, null, plain, ground, theta(name), rough)
        for name in ground.part.effects
    )
    found = _refined(fitter, ground, null, probed)
    if plainer := _contained(fitter, ground, null, min(found, key=_cost, default=null)):
        null, plain = plainer[0], residuals(ground, plainer[0])
        found = _refined(fitter, ground, null, found)
    order, left = ranked(null, found), plain
    fewer = next(r for r in order if r.candidate is null)
    for size in range(1, most + 1):
        left = residuals(ground, order[0].candidate)
        # Of a large gap one effect may explain half and still be no likelier than none; two may explain it all.
        base = order[0] if size > 1 else next((r for r in order if r.candidate.effects), order[0])
        beside = left if base is order[0] else residuals(ground, base.candidate)
        if len(base.candidate.effects) < size or size == most or not _leaves_something(base, beside, ground):
            break
        # Alone, an effect may explain much by values that the datasheet does not allow; beside another it need not.
        hopeful = [base] if size > 1 else [r for r in order if r.candidate.effects]
        if not any(now < HOPEFUL * was for r in hopeful for now, was in zip(r.shares, fewer.shares, strict=True)):
            break
        fewer = base
        larger = _refined(fitter, ground, null, fitter.run(_larger(order, base, beside, ground)))
        found = [*found, *larger]
        found += _exchanged(fitter, ground, null, larger, found)
        found = _best_of_each([*found, *_contained(fitter, ground, *found)])
        order = _worthy(ranked(null, found))
    return Explained(ground, tuple(order), plain, left)


def residuals(ground: Ground, candidate: Candidate) -> tuple[Complex, ...]:
    """What an explanation leaves of a part, weighted, (P, H, n) per sweep."""
    return tuple(Problem(ground, [CATALOGUE[name] for name in candidate.effects]).residuals(candidate.fit))


def _rough(ground: Ground) -> tuple[Stage, ...]:
    """First stages of a fit: only the plant has resonances that need them."""
    return (COARSE, MIDDLE) if ground.part.path == "plant" else ()


def _rough_beside(first: Candidate, ground: Ground) -> tuple[Stage, ...]:
    """First stages of a fit beside ``first`` from a good start: those within whose floor that is not yet.

    To the others all that is left is noise: they would lead a good start of a faint effect anywhere.
    """
    problem = Problem(ground, [CATALOGUE[name] for name in first.effects])
    return tuple(stage for stage in _rough(ground) if not problem.within_floor(first.fit, stage))


def _with(
    name: str,
    first: Candidate,
    null: Candidate,
    left: Sequence[Complex],
    ground: Ground,
    theta: Real,
    rough: tuple[Stage, ...],
) -> Task:
    """Task to fit one more effect beside those of ``first``, which leaves ``left``, from deviations ``theta``.

    ``rough`` are the stages from a good start.
    """
    beginnings, effects = _starts(first, name, left, ground), (*first.effects, name)
    held = first if any(slow_to_compute(e) for e in first.effects) else None
    if name in SHARP:
        return Task(ground, effects, beginnings, first.fit.theta, (PROBE,), held, null.occam)
    # Without rough stages a probe would end far from the valley; the plant alone is costly.
    last = PROBE if ground.part.path == "plant" else EXACT
    first_stages = rough if name in LOOKED_FOR else _rough(ground)
    return Task(ground, effects, beginnings, theta, (*first_stages, last), held, null.occam)


def _starts(
    first: Candidate, name: str, left: Sequence[Complex], ground: Ground
) -> tuple[tuple[dict[str, float], ...], ...]:
    """Starts of an effect beside those of ``first``; a nonlinear one's found in the sweep that drives it most."""
    sweeps = range(len(ground.observations))
    k = max(sweeps, key=lambda k: _driven(name, ground.observations[k])) if CATALOGUE[name].nonlinear else 0
    o, z = ground.observations[k], left[k]
    return tuple((*first.fit.values, s) for s in starts(CATALOGUE[name], first.fit.rig, z, o, ground))


def _driven(name: str, o: Observation) -> float:
    """How far a sweep drives a nonlinear effect: by the rate of the current, A/s, or by the rotor's motion, m."""
    return largest_rate(o) if CATALOGUE[name].path == "amplifier" else float(np.abs(o.Y).max())


def _leaves_something(best: Ranked, left: Sequence[Complex], ground: Ground) -> bool:
    if max(best.shares) < MIXED:
        return False
    everywhere = list(zip(left, ground.observations, strict=True))
    if any(significance(z, o) > REMAINS for z, o in everywhere):
        return True
    return any(alone_hz(ground.part, z, o) is not None for z, o in everywhere)


def _worthy(everything: Sequence[Ranked]) -> list[Ranked]:
    return renormalised([r for r in everything if _worth_it(r, everything)])


def _to_the_end(ground: Ground, candidates: Iterable[Candidate]) -> Iterable[Task]:
    return (Task(ground, c.effects, (c.fit.values,), c.fit.theta, (EXACT,)) for c in candidates)


def _exchanged(
    fitter: Fitter, ground: Ground, null: Candidate, mixtures: Sequence[Candidate], found: Sequence[Candidate]
) -> list[Candidate]:
    """The mixture that leaves least, an alias in the place of one of its effects, where it leaves something.

    Alone the two looked alike and one was taken; beside another effect it may be the other that fits.
    """
    if not mixtures:
        return []
    best = min(mixtures, key=_cost)
    mixture = next(r for r in ranked(null, found) if r.candidate is best)
    if not _leaves_something(mixture, residuals(ground, best), ground):
        return []
    singles = {c.effects[0]: c.fit.values[0] for c in found if len(c.effects) == 1}
    tried = {frozenset(c.effects) for c in found}
    probed = fitter.run(
        Task(ground, effects, (values,), best.fit.theta, (PROBE,))
        for k, name in enumerate(best.effects)
        for alias in CATALOGUE[name].aliases
        if alias in singles and alias not in best.effects
        for effects in [(*best.effects[:k], alias, *best.effects[k + 1 :])]
        for values in [(*best.fit.values[:k], singles[alias], *best.fit.values[k + 1 :])]
        if frozenset(effects) not in tried
    )
    return fitter.run(_to_the_end(ground, sorted(probed, key=_cost)[:1]))


def _contained(fitter: Fitter, ground: Ground, *found: Candidate) -> list[Candidate]:
    """The explanations with one effect less than the one that leaves least, where they do better from where that ended.

    A fit that stopped short of its valley leaves what any further effect seems to explain, by going on from there.
    """
    best, costs = min(found, key=_cost), {frozenset(c.effects): _cost(c) for c in found}
    tasks = []
    for without in best.effects:
        kept = [k for k, name in enumerate(best.effects) if name != without]
        values = tuple(best.fit.values[k] for k in kept)
        tasks.append(Task(ground, tuple(best.effects[k] for k in kept), (values,), best.fit.theta, (EXACT,)))
    return [c for c in fitter.run(tasks) if _cost(c) < costs.get(frozenset(c.effects), np.inf) - LOST]


def _best_of_each(found: Sequence[Candidate]) -> list[Candidate]:
    """Of explanations by the same effects the one that leaves least."""
    best: dict[frozenset[str], Candidate] = {}
    for c in found:
        these = frozenset(c.effects)
        if these not in best or _cost(c) < _cost(best[these]):
            best[these] = c
    return list(best.values())


def _larger(order: Sequence[Ranked], base: Ranked, left: Sequence[Complex], ground: Ground) -> Iterable[Task]:
    """Mixtures of one effect more: those of ``base`` with every other effect, and pairs of good singles."""
    best, null = base.candidate, next(r.candidate for r in order if not r.candidate.effects)
    tried, rough = set(), _rough_beside(best, ground)
    for name in ground.part.effects:
        if name not in best.effects:
            tried.add(frozenset((*best.effects, name)))
            yield _with(name, best, null, left, ground, best.fit.theta, rough)
    if len(best.effects) > 1:
        return
    singles = [r.candidate for r in order if len(r.candidate.effects) == 1][:PAIRED]
    for a, b in combinations(singles, 2):
        if frozenset((*a.effects, *b.effects)) in tried:
            continue
        yield _with(b.effects[0], a, null, residuals(ground, a), ground, a.fit.theta, _rough_beside(a, ground))


def _refined(fitter: Fitter, ground: Ground, null: Candidate, probed: Sequence[Candidate]) -> list[Candidate]:
    """The probed candidates, those that may win fitted to the end.

    One that does worse than the plain twin, which it contains, is lost: it begins again at the plain twin.
    """
    lost = [c for c in probed if _cost(c) > _cost(null) + LOST and not any(map(slow_to_compute, c.effects))]
    again = fitter.run(Task(ground, c.effects, (c.fit.values,), null.fit.theta, (EXACT,)) for c in lost)
    probed = [*(c for c in probed if c not in lost), *again]
    order = [r for r in ranked(null, probed) if r.candidate is not null]
    near = [r.candidate for r in order if r.log_evidence > order[0].log_evidence - WITHIN][:REFINED]
    near += [r.candidate for r in order if r.candidate not in near and _aliases(r.candidate, near[0])][:ALIASES]
    refined = [*fitter.run(_to_the_end(ground, near)), *(r.candidate for r in order if r.candidate not in near)]
    lent = {frozenset(c.effects): c for c in fitter.run(_lent(ground, refined[: len(near)], refined))}
    kept = []
    for c in refined:
        other = lent.pop(frozenset(c.effects), c)
        kept.append(c if _cost(c) <= _cost(other) else other)
    return [*kept, *lent.values()]


def _lent(ground: Ground, lenders: Sequence[Candidate], known: Sequence[Candidate]) -> Iterable[Task]:
    """Tasks to fit known aliases from where their like ended, where they did worse: a resonance has many valleys."""
    costs = {frozenset(c.effects): _cost(c) for c in known}
    tried: set[frozenset[str]] = set()
    for lender in sorted(lenders, key=_cost):
        for k, name in enumerate(lender.effects):
            for alias in CATALOGUE[name].aliases:
                likened = CATALOGUE[alias].likened.get(name)
                effects = (*lender.effects[:k], alias, *lender.effects[k + 1 :])
                these = frozenset(effects)
                if likened is None or alias not in ground.part.effects or len(these) < len(effects) or these in tried:
                    continue
                values = likened(lender.fit.values[k])
                if values and costs.get(these, np.inf) > _cost(lender):
                    tried.add(these)
                    starts = ((*lender.fit.values[:k], values, *lender.fit.values[k + 1 :]),)
                    yield Task(ground, effects, starts, lender.fit.theta, (EXACT,))


def _aliases(a: Candidate, b: Candidate) -> bool:
    """Whether two explanations are the same but for one effect that looks like the other's."""
    one, other = set(a.effects) - set(b.effects), set(b.effects) - set(a.effects)
    return len(one) == len(other) == 1 and bool(other & set(CATALOGUE[next(iter(one))].aliases))


def _cost(c: Candidate) -> float:
    return c.fit.chi_square + c.fit.penalty


def _worth_it(mixture: Ranked, order: Sequence[Ranked]) -> bool:
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
    alias = any(b in CATALOGUE[a].aliases for a in effects for b in effects)
    little, left = 0.15 if alias else MIXED, np.array(mixture.shares)
    return all(np.any((np.array(r.shares) > little) & (left < np.array(r.shares) / 3)) for r in smaller)
