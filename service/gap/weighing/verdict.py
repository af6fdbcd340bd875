"""From fitted explanations to a verdict: an effect, several, none of these, or no gap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.evidence import TEMPERATURE
from service.gap.weighing.alike import alike, alike_beside
from service.gap.weighing.ranking import Ranked, renormalised
from service.gap.weighing.shrinkage import closure_of
from service.gap.weighing.significance import SIGNIFICANT
from sim.effects import CATALOGUE
from sim.wording import in_words

MAX_SHARE_LEFT = 0.25
"""Share of the gap that may be left by another law of the same effect; more is something else."""
CLOSES = 1 - 1.2 * MAX_SHARE_LEFT
"""Closure on unseen data below which an explanation is none."""
MAX_SHARE_LEFT_BY_SEVERAL = 0.05
"""The same for several effects in one part, or for one whose strength is at the end of its range: they bend to many
things that they are not."""
MIXTURE_SHARE = 0.02
"""Share of the gap that a first effect must leave for a second one, of another kind, to be looked for."""
VISIBLE_J = 1.5
"""J on the unseen sweep from which there is a gap that could be closed."""
LARGEST_CLASS = 3
"""Effects that a class lists, the likeliest; what else is not told apart is told in words."""
LEAVES, LEAVES_ALL = 6.0, 8.0
"""Normal deviates of what an effect leaves, and of a gap without any, from which it may be none of these."""
SURE_OF_NONE = 0.95
"""Probability that is stated where a test of its own says "none of these", or that the datasheet is of another rig.
Such tests have no rivals to be weighed against. Of more than 70 such verdicts in blind trials and on rigs of another
program all came true; laws of an effect that nobody thought of make it less. `benchmarks/gap.py` prints how often."""
LEAST_RIVALS = 1e-12
"""Probability that rivals keep however certain an explanation was: unseen data can still speak for them."""


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
        return closure_of(self.before, self.after) if self.before > VISIBLE_J else None


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
    allowed = MAX_SHARE_LEFT_BY_SEVERAL if bent else MAX_SHARE_LEFT
    return remaining > LEAVES and (best.unexplained > allowed or _of_one_sweep(best) > MAX_SHARE_LEFT)


def _of_one_sweep(best: Ranked) -> float:
    """The largest share left of a sweep's fundamental: one that explains another sweep only explains neither."""
    return max(best.shares[::2], default=0.0)


def decide(
    order: Sequence[Ranked],
    remaining: float,
    there: HeldOut,
    significant: float,
    elsewhere: Sequence[Ranked] = (),
    added_up: tuple[float, float] = (0.0, 0.0),
) -> Verdict:
    """Verdict on one part of the loop, from its ranked explanations.

    Parameters
    ----------
    remaining : significance (normal deviate) of what the best explanation leaves
    there : the part on the unseen sweep
    significant : significance of the plain twin's gap on the sweeps fitted and unseen
    elsewhere : what would explain it by an effect of another part
    added_up : significance of what the plain twin leaves in all bands and channels together, fitted and unseen each
    """
    best = order[0]
    if not best.candidate.effects:
        shown_twice = min(added_up) > LEAVES  # a little everywhere, and on unseen data again
        if rejected(best, min(remaining, significant)) or shown_twice:
            reason = "no effect of the catalogue explains any of the gap"
            return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,))
        return Verdict("no_gap", (), (), best.probability, ())
    effects = best.candidate.effects
    words = " and ".join(map(in_words, effects))
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
    return probability * odds / (probability * odds + max(1 - probability, LEAST_RIVALS))
