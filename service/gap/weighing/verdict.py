"""From fitted explanations to a verdict: an effect, several, none of these, or no gap."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.gap.fitting.candidates import LAW_ERROR, Candidate
from service.gap.fitting.evidence import TEMPERATURE, log_evidence, probabilities
from service.gap.weighing.shrinkage import closure_of
from service.gap.weighing.significance import SIGNIFICANT
from sim.effects import CATALOGUE, aliases

DETECTED = 5.0
"""Log evidence by which an effect must beat the plain twin, some 25 candidates being tried: in 134 parts of rigs of an
independent program that had no effect there, the largest advantage by chance was 2.2, with a tail like exp(-x)."""
UNEXPLAINED = 0.25
"""Share of the gap that may be left by another law of the same effect; more is something else."""
CLOSES = 1 - 1.2 * UNEXPLAINED
"""Closure on unseen data below which an explanation is none."""
UNEXPLAINED_BY_SEVERAL = 0.05
"""The same for several effects in one part, or for one whose strength is at the end of its range: they bend to many
things that they are not."""
MIXED = 0.02
"""Share of the gap that a first effect must leave for a second one, of another kind, to be looked for."""
VISIBLE = 1.5
"""J on the unseen sweep from which there is a gap that could be closed."""
ALIKE = 6.0
"""Log evidence behind the best up to which a candidate counts as not told apart."""
LARGEST_CLASS = 3
"""Effects that a class lists, the likeliest; what else is not told apart is told in words."""
LEAVES, LEAVES_ALL = 6.0, 8.0
"""Normal deviates of what an effect leaves, and of a gap without any, from which it may be none of these."""
SURE_OF_NONE = 0.95
"""Probability that is stated where a test of its own says "none of these", or that the datasheet is of another rig.
Such tests have no rivals to be weighed against. Of more than 70 such verdicts in blind trials and on rigs of another
program all came true; laws of an effect that nobody thought of make it less. `benchmarks/gap.py` prints how often."""
SURE = 1e-12
"""Probability that rivals keep however certain an explanation was: unseen data can still speak for them."""
CLEAR = 30.0
"""Excess chi-square of a group from which the share that an explanation leaves of it means something."""


Groups = Sequence[tuple[float, int]]
"""(chi-square, number of residuals) each"""


@dataclass(frozen=True, eq=False)
class Ranked:
    """An explanation with its evidence and probability."""

    candidate: Candidate
    log_evidence: float
    """`DETECTED` taken off for every effect: an effect is named only for good reason"""
    probability: float
    unexplained: float
    """share of the plain twin's excess chi-square that is left"""
    shares: tuple[float, ...] = ()
    """the same for the fundamental and for the harmonics of each sweep in turn; 0 where there was no gap"""
    across: tuple[float, ...] = ()
    """the same for the fundamental in the plane that was not excited, sweep by sweep"""
    open_strength: tuple[str, ...] = ()
    """effects that grow with amplitude, and without which the fitted data are as likely: nothing tells how strong they
    are on louder ones"""

    @property
    def apart(self) -> tuple[float, ...]:
        """Shares of everything that is told apart: what couples the planes shows where little else does."""
        return (*self.shares, *self.across)


@dataclass(frozen=True)
class Verdict:
    """What the gap is. ``kind``: "effect", "effects", "no_gap" or "none_of_these"."""

    kind: str
    effects: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    probability: float
    """that exactly these are there, each or one of its class"""
    reasons: tuple[str, ...]
    settled: bool = True
    """False where the rig drifted so much that the gap could not be judged"""
    unexplained: str | None = None
    """the part of the loop that no known effect explains"""
    another_rig: bool = False
    """whether the datasheet seems to be of another rig, so that there is no gap to speak of"""
    bent: bool = False
    """whether what is not explained is proven not to be in proportion to the excitation"""
    also_alike: tuple[str, ...] = ()
    """what the data cannot tell from the effects either, beyond what the classes list"""
    outdated: tuple[str, ...] = ()
    """effects that the twin names and the rig does not show as named"""

    def with_classes(self, classes: Sequence[tuple[str, ...]]) -> Verdict:
        """The same with these alias classes, each cut to what a class lists."""
        more = (name for group in classes for name in group[LARGEST_CLASS:])
        also = tuple(dict.fromkeys((*self.also_alike, *more)))
        return replace(self, indistinguishable=tuple(g[:LARGEST_CLASS] for g in classes), also_alike=also)


@dataclass(frozen=True)
class HeldOut:
    """One part of the loop on the unseen sweep: with the plain twin, and with the explanation that is best."""

    before: float
    """J of the plain twin, harmonics included"""
    after: float
    gap: float = 0.0
    """significance of what the plain twin leaves at the excited frequency"""
    left: float = 0.0
    """the same of the explanation"""
    closes: float = 1.0
    """closure at the excited frequency alone"""
    support: float = 0.0
    """log likelihood of the explanation less the plain twin's; negative where what it predicts is not there"""

    @property
    def fails(self) -> bool:
        """Whether what explains the fitted data is none here.

        A small gap may be closed in part by chance, so what is left must be beyond chance itself.
        """
        return min(self.gap, self.left) > SIGNIFICANT and self.closes < CLOSES

    @property
    def closure(self) -> float | None:
        """Share of the gap that is closed, harmonics included; None where the plain twin has none there."""
        return closure_of(self.before, self.after) if self.before > VISIBLE else None


def noise_levels(null: Candidate, candidates: Sequence[Candidate]) -> list[float]:
    """Chi-square of each group that a right twin leaves: no more than one per residual, nor than the best fit has."""
    return _levels([c.fit.groups for c in (null, *candidates)])


def _levels(groups: Sequence[Groups]) -> list[float]:
    return [float(min(one[0][1], *(chi for chi, _ in one))) for one in zip(*groups, strict=True)]


def ranked(null: Candidate, candidates: Sequence[Candidate]) -> list[Ranked]:
    """Explanations by falling evidence, the plain twin (no effects) among them."""
    noise = noise_levels(null, candidates)
    everything = [null, *candidates]
    logs = np.array([log_evidence(c.fit, c.occam, noise) - DETECTED * len(c.effects) for c in everything])
    p = probabilities(logs)
    across, quiet = [c.fit.across for c in everything], _levels([c.fit.across for c in everything])
    out = [
        Ranked(
            c,
            float(log),
            float(q),
            unexplained(c, null, noise),
            shares(c.fit.groups, null.fit.groups, noise),
            shares(there, across[0], quiet),
            _open_strength(c, log, everything, logs),
        )
        for c, log, q, there in zip(everything, logs, p, across, strict=True)
    ]
    return sorted(out, key=lambda r: -r.log_evidence)


def _open_strength(
    candidate: Candidate, log: float, everything: Sequence[Candidate], logs: Iterable[float]
) -> tuple[str, ...]:
    """Effects of an explanation that grow with amplitude, and without which one of fewer effects is as likely.

    What answers in proportion is as small on any sweep as on the fitted ones.
    """
    likely = [(set(c.effects), other) for c, other in zip(everything, logs, strict=True)]

    def without(effect: str) -> float:
        rest = set(candidate.effects) - {effect}
        return max(other for effects, other in likely if effects <= rest)

    grow = (effect for effect in candidate.effects if CATALOGUE[effect].nonlinear)
    return tuple(effect for effect in grow if without(effect) >= log)


def renormalised(order: Sequence[Ranked]) -> list[Ranked]:
    """The same explanations, others being out of the question."""
    p = probabilities(np.array([r.log_evidence for r in order]))
    return [replace(r, probability=float(q)) for r, q in zip(order, p, strict=True)]


def unexplained(candidate: Candidate, null: Candidate, noise: Sequence[float]) -> float:
    """Share of the plain twin's excess that an explanation leaves, the datasheet's values at their own price."""
    before = max(null.fit.cost - sum(noise), 1e-9)
    return float((candidate.fit.cost - sum(noise)) / before)


def shares(groups: Groups, null: Groups, noise: Sequence[float]) -> tuple[float, ...]:
    """Share of the plain twin's excess that is left, group by group; 0 where the plain twin has no clear excess."""
    out = []
    for (after, _), (before, _), level in zip(groups, null, noise, strict=True):
        clear = before - level > CLEAR
        out.append(float(max(after - level, 0.0) / (before - level)) if clear else 0.0)
    return tuple(out)


def alike(best: Ranked, order: Sequence[Ranked], elsewhere: Sequence[Ranked] = ()) -> tuple[str, ...]:
    """Single effects that the data cannot tell from the best one, the best first.

    Known aliases that fit as well count whatever the number of their parameters: how many a law has says little
    of how likely it is. As well is what leaves no more than the error of the best one's own law would: a large effect
    shows shapes of a mode that differ by less than two programs do, and a housing has them equal.
    """
    name = best.candidate.effects[0]
    null = next(r.candidate.fit for r in order if not r.candidate.effects)
    cost = best.candidate.fit.cost
    as_well = max(2 * ALIKE, LAW_ERROR**2 * (null.cost - cost))

    def close(r: Ranked) -> bool:
        other = r.candidate.effects[0]
        if r.log_evidence > best.log_evidence - ALIKE:
            return True
        return aliases(name, other) and r.candidate.fit.cost < cost + as_well

    near = [r for r in order if len(r.candidate.effects) == 1 and close(r)]
    near += [r for r in elsewhere if r.log_evidence > best.log_evidence - ALIKE]
    near.sort(key=lambda r: (r is not best, -r.log_evidence))
    return tuple(dict.fromkeys(r.candidate.effects[-1] for r in near))


def alike_beside(best: Ranked, order: Sequence[Ranked]) -> tuple[tuple[tuple[str, ...], ...], float]:
    """Classes of a mixture's effects that known aliases could stand for beside the others, and what all of those add.

    The best one's effect first in each; the number is the probability of the mixtures that differ in one effect so.
    """
    effects, classes, added = best.candidate.effects, [], 0.0
    near = [r for r in order if r is not best and r.log_evidence > best.log_evidence - ALIKE]
    for name in effects:
        rest = set(effects) - {name}
        group = [name]
        for r in near:
            other = set(r.candidate.effects) - rest
            if len(r.candidate.effects) != len(effects) or len(other) != 1 or not rest <= set(r.candidate.effects):
                continue
            alias = next(iter(other))
            if aliases(name, alias):
                group.append(alias)
                added += r.probability
        if len(group) > 1:
            classes.append(tuple(group))
    return tuple(classes), added


def at_the_end_of_its_range(candidate: Candidate) -> bool:
    """Whether the strength of an effect would have to be one that such effects do not have."""
    return any(
        p.strength and (effect, p.name) in candidate.fit.ends
        for effect in candidate.effects
        for p in CATALOGUE[effect].parameters
    )


def rejected(best: Ranked, remaining: float) -> bool:
    """Whether the sweeps that were fitted reject their best explanation: it leaves too much of the gap.

    ``remaining`` is the significance (normal deviate) of what it leaves.
    """
    if not best.candidate.effects:
        return remaining > LEAVES_ALL
    bent = len(best.candidate.effects) > 1 or at_the_end_of_its_range(best.candidate)
    allowed = UNEXPLAINED_BY_SEVERAL if bent else UNEXPLAINED
    return remaining > LEAVES and (best.unexplained > allowed or _of_one_sweep(best) > UNEXPLAINED)


def _of_one_sweep(best: Ranked) -> float:
    """The largest share left of a sweep's fundamental: one that explains another sweep only explains neither."""
    return max(best.shares[::2], default=0.0)


def decide(
    order: Sequence[Ranked],
    remaining: float,
    there: HeldOut,
    significant: float,
    elsewhere: Sequence[Ranked] = (),
) -> Verdict:
    """Verdict on one part of the loop, from its ranked explanations.

    Parameters
    ----------
    remaining : significance (normal deviate) of what the best explanation leaves
    there : the part on the unseen sweep
    significant : significance of the plain twin's gap on the sweeps fitted and unseen
    elsewhere : what would explain it by an effect of another part
    """
    best = order[0]
    if not best.candidate.effects:
        if rejected(best, min(remaining, significant)):
            reason = "no effect of the catalogue explains any of the gap"
            return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,))
        return Verdict("no_gap", (), (), best.probability, ())
    effects = best.candidate.effects
    words = " and ".join(effects).replace("_", " ")
    closed = 1 - best.unexplained if there.closure is None else there.closure
    if rejected(best, remaining) or (remaining > LEAVES and closed < CLOSES):
        share = min(max(best.unexplained, _of_one_sweep(best), 1 - closed), 1.0)
        reason = f"the best explanation, {words}, leaves {100 * share:.0f} % of the gap"
        return Verdict("none_of_these", (), (), float(min(0.99, 0.5 + share)), (reason,))
    if there.fails:
        share = min(1 - there.closes, 1.0)
        reason = f"the best explanation, {words}, leaves {100 * share:.0f} % of the gap on unseen data"
        return Verdict("none_of_these", (), (), float(min(0.99, 0.5 + share)), (reason,))
    weighed = renormalised([*order, *elsewhere]) if elsewhere else order
    if len(effects) > 1:
        classes, added = alike_beside(weighed[0], weighed)
        probability = weighed[0].probability + added
    else:
        group = alike(best, order, elsewhere)
        classes = (group,) if len(group) > 1 else ()
        listed = group[:LARGEST_CLASS]
        singles = [r for r in weighed if len(r.candidate.effects) == 1 and r.candidate.effects[0] in listed]
        probability = sum(r.probability for r in singles) if classes else weighed[0].probability
    probability = supported(float(probability), there.support)
    if probability < 0.5 and there.support < 0:
        if significant <= SIGNIFICANT:
            return Verdict("no_gap", (), (), 1 - probability, ())
        reason = f"the best explanation, {words}, predicts a gap on unseen data that is not there"
        return Verdict("none_of_these", (), (), 1 - probability, (reason,))
    kind = "effect" if len(effects) == 1 else "effects"
    return Verdict(kind, effects, (), probability, ()).with_classes(classes)


def supported(probability: float, support: float) -> float:
    """Probability of an explanation after unseen data spoke against it; data for it are for its rivals too.

    >>> supported(0.9, 3.0), round(supported(0.9, -TEMPERATURE * math.log(9.0)), 3), supported(1.0, -1e9)
    (0.9, 0.5, 0.0)
    """
    if support >= 0:
        return probability
    odds = math.exp(support / TEMPERATURE)
    return probability * odds / (probability * odds + max(1 - probability, SURE))
