"""The verdict on one part of the loop: an effect, several, none of these, or no gap."""

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
from sim.effects.controller_mismatch import ADDED
from sim.wording import in_words

MAX_SHARE_LEFT = 0.25
"""Share of the gap up to which it may be left by another program's law of the same effect."""
CLOSES = 1 - 1.2 * MAX_SHARE_LEFT
"""Closure on unseen data below which an explanation is rejected."""
MAX_SHARE_LEFT_BY_SEVERAL = 0.05
"""The same share for several effects in one part, or for one whose strength is at the end of its range, as they can
approximate many other laws, and for one that has no other law."""
EXACT_LAWS = frozenset({"magnetic_cross_coupling", "rotor_inertia", "sensor_gain"})
"""Effects that are constants, a matrix, a mass, a gain: no program states their law otherwise, and they may leave no
more than several effects. Of a dozen rigs of four programs whose gap was clear they left 2 % at most; of sensors that
heard the other plane, which is no effect, the magnets' coupling left 13 %."""
MAX_SHARE_LEFT_BY_A_FILTER = 0.002
"""The same share for a controller with a filter that its datasheet has not: five parameters more follow much else, and
the arithmetic of a controller leaves nothing. It left 1e-4 of a low-pass filter with one pole, 1e-3 of two notches and
of a delay of three samples."""
MIXTURE_SHARE = 0.02
"""Share of the gap that an effect must leave for a second one, no alias, to be searched for."""
WHOLE_OF_ANOTHER_LAW = 0.01
"""Share of the whole gap that another law of a nonlinear effect may leave in one group, however much of that group it
is: a law's error is in proportion to the whole effect. Six plays, fitted by a band of them, left 0.0024 of the gap in
harmonics that held 0.005 of it, and that was explained as eddy currents; a radial stop that Hertz's law stiffens left
0.0025, which was half of what a quiet sweep showed."""
VISIBLE_J = 1.5
"""J of the plain twin on the unseen sweep from which a closure there is used."""
LARGEST_CLASS = 3
"""Number of effects that a class lists, the likeliest; further ones are listed in a note."""
LEAVES, LEAVES_ALL = 6.0, 8.0
"""Significance of an effect's residuals, and of the gap without an effect, from which it may be none of these."""
SURE_OF_NONE = 0.95
"""Probability that is stated where an absolute test says "none of these" or "datasheet of another rig". Such a test has
no rivals to be weighed against. More than 70 such verdicts in blind trials and on rigs of another program were all
right; unknown laws of an effect make it less than that. `benchmarks/gap.py` prints how often it is right."""
LEAST_RIVALS = 1e-12
"""Least probability of all rivals together, so that unseen data can still favour them."""


@dataclass(frozen=True)
class Verdict:
    """What the gap is. ``kind``: "effect", "effects", "no_gap" or "none_of_these"."""

    kind: str
    effects: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    probability: float
    """that exactly these effects are there, each of them or one of its class"""
    reasons: tuple[str, ...]
    settled: bool = True
    """False where the rig drifted so much that the gap could not be judged"""
    unexplained: str | None = None
    """the part of the loop that no known effect explains"""
    another_rig: bool = False
    """whether the datasheet seems to be of another rig, so that its gap is meaningless"""
    misstated: bool = False
    """whether a value that the datasheet states explains the gap where it is another"""
    nonlinear: bool = False
    """whether what no effect explains is proven to be nonlinear"""
    also_alike: tuple[str, ...] = ()
    """further effects or causes that the data cannot distinguish from the effects, beyond the classes"""
    outdated: tuple[str, ...] = ()
    """effects that the twin names and the rig does not show as named"""
    beside: tuple[str, ...] = ()
    """parts whose own small gap no effect explains, in words; what is named in others may have leaked into them"""

    def with_classes(self, classes: Sequence[tuple[str, ...]]) -> Verdict:
        """The verdict with these alias classes, each cut to `LARGEST_CLASS`; the rest goes to ``also_alike``."""
        more = (name for group in classes for name in group[LARGEST_CLASS:])
        also = tuple(dict.fromkeys((*self.also_alike, *more)))
        return replace(self, indistinguishable=tuple(g[:LARGEST_CLASS] for g in classes), also_alike=also)


@dataclass(frozen=True)
class HeldOut:
    """One part of the loop on the unseen sweep: with the plain twin, and with the best explanation."""

    before: float
    """J of the plain twin, harmonics included"""
    after: float
    """J of the explanation, harmonics included"""
    gap: float = 0.0
    """significance of the plain twin's residuals at the excited frequency"""
    left: float = 0.0
    """significance of the explanation's residuals at the excited frequency"""
    closes: float = 1.0
    """closure at the excited frequency alone"""
    support: float = 0.0
    """log likelihood of the explanation less the plain twin's; negative where what it predicts is not there"""

    @property
    def fails(self) -> bool:
        """Whether the explanation of the fitted data is rejected by these: it closes too little.

        Both the gap and what is left must be significant, as a small gap may fail to close by chance.
        """
        return min(self.gap, self.left) > SIGNIFICANT and self.closes < CLOSES

    @property
    def closure(self) -> float | None:
        """Share of the gap that is closed, harmonics included; None where the plain twin has none there."""
        return closure_of(self.before, self.after) if self.before > VISIBLE_J else None


def at_the_end_of_its_range(candidate: Candidate) -> bool:
    """Whether a strength parameter of an effect is at an end of its range, but for the end beside its null.

    There it hardly acts, as one of two laws of saturation does where the other explains all.
    """
    return any(
        p.strength and candidate.fit.ends.get((effect, p.name)) in ({"high"} if p.null <= p.low else {"low", "high"})
        for effect in candidate.effects
        for p in CATALOGUE[effect].parameters
    )


def has_added_filter(candidate: Candidate) -> bool:
    """Whether an explanation has a controller with a filter that its datasheet has not."""
    if "controller_mismatch" not in candidate.effects:
        return False
    mismatch = candidate.fit.values[candidate.effects.index("controller_mismatch")]
    return any(mismatch.get(name, 0.0) for name, _ in ADDED)


def rejected(best: Ranked, remaining: float) -> bool:
    """Whether the fitted sweeps reject their best explanation: it leaves too much of the gap, significantly.

    ``remaining`` is the significance (normal deviate) of its residuals.
    """
    if not best.candidate.effects:
        return remaining > LEAVES_ALL
    flexible = len(best.candidate.effects) > 1 or at_the_end_of_its_range(best.candidate)
    strict = flexible or best.candidate.effects[0] in EXACT_LAWS
    allowed = MAX_SHARE_LEFT_BY_SEVERAL if strict else MAX_SHARE_LEFT
    if has_added_filter(best.candidate):
        allowed = MAX_SHARE_LEFT_BY_A_FILTER
    of_one_sweep = 0.0 if leaves_an_error_of_a_bending_law(best) else _worst_sweep_share(best)
    return remaining > LEAVES and (best.unexplained > allowed or of_one_sweep > MAX_SHARE_LEFT)


def leaves_an_error_of_a_bending_law(best: Ranked) -> bool:
    """Whether what is left may be the error of a nonlinear effect's law, which goes with the whole effect.

    Where a stop is reached in a few lines of a quiet sweep, and in most of a loud one, the gap of the loud one is
    hundreds of times as large, and the law's error there is what is fitted.
    """
    nonlinear = any(CATALOGUE[name].nonlinear for name in best.candidate.effects)
    return nonlinear and best.unexplained <= WHOLE_OF_ANOTHER_LAW


def _worst_sweep_share(best: Ranked) -> float:
    """The largest share left of a sweep's fundamental: an effect must explain every sweep, not only the loudest."""
    return max(best.shares[::2], default=0.0)


def decide(
    order: Sequence[Ranked],
    remaining: float,
    there: HeldOut,
    significant: float,
    elsewhere: Sequence[Ranked] = (),
    added_up: tuple[float, float] = (0.0, 0.0),
    at_few_lines: float = 0.0,
) -> Verdict:
    """Verdict on one part of the loop, from its ranked explanations.

    Parameters
    ----------
    remaining : significance (normal deviate) of the best explanation's residuals
    there : the part on the unseen sweep
    significant : significance of the plain twin's gap on the sweeps fitted and unseen
    elsewhere : explanations of the part's gap by an effect of another part
    added_up : significance of all of the plain twin's residuals together, on the sweeps fitted and unseen
    at_few_lines : significance of its gap on a sweep fitted and on the unseen one each, every value counted in full
    """
    best = order[0]
    if not best.candidate.effects:
        return _without_effect(best, max(min(remaining, significant), at_few_lines), added_up)
    words = " and ".join(map(in_words, best.candidate.effects))
    if (share := _share_too_much(best, remaining, there)) is not None:
        reason = f"the best explanation, {words}, leaves {100 * share:.0f} % of the gap"
        return Verdict("none_of_these", (), (), float(min(0.99, 0.5 + share)), (reason,))
    if there.fails:
        share = min(1 - there.closes, 1.0)
        reason = f"the best explanation, {words}, leaves {100 * share:.0f} % of the gap on unseen data"
        return Verdict("none_of_these", (), (), float(min(0.99, 0.5 + share)), (reason,))
    classes, of_class = _classes(order, elsewhere)
    probability = supported(of_class, there.support)
    if probability < 0.5 and there.support < 0:
        if significant <= SIGNIFICANT:
            return Verdict("no_gap", (), (), 1 - probability, ())
        reason = f"the best explanation, {words}, predicts a gap on unseen data that is not there"
        return Verdict("none_of_these", (), (), 1 - probability, (reason,))
    kind = "effect" if len(best.candidate.effects) == 1 else "effects"
    return Verdict(kind, best.candidate.effects, (), probability, ()).with_classes(classes)


def _without_effect(null: Ranked, remaining: float, added_up: tuple[float, float]) -> Verdict:
    """The verdict where the plain twin is the best explanation: no gap, or one that no effect explains.

    There is one where a band or channel shows it, or all residuals together do, on fitted and on unseen data each. What
    stands out in a few lines of both is no outlier.
    """
    if rejected(null, remaining) or min(added_up) > LEAVES:
        reason = "no effect of the catalogue explains any of the gap"
        return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,))
    return Verdict("no_gap", (), (), null.probability, ())


def _share_too_much(best: Ranked, remaining: float, there: HeldOut) -> float | None:
    """Share of the gap that the best effects leave, on fitted data or of unseen ones; None where it is acceptable."""
    closed = 1 - best.unexplained if there.closure is None else there.closure
    if not (rejected(best, remaining) or (remaining > LEAVES and closed < CLOSES)):
        return None
    return min(max(best.unexplained, _worst_sweep_share(best), 1 - closed), 1.0)


def _classes(order: Sequence[Ranked], elsewhere: Sequence[Ranked]) -> tuple[tuple[tuple[str, ...], ...], float]:
    """Alias classes of the best effects, and the probability that each of them or one of its class is there."""
    best, weighed = order[0], renormalised([*order, *elsewhere]) if elsewhere else order
    if len(best.candidate.effects) > 1:
        classes, added = alike_beside(weighed[0], weighed)
        return classes, float(weighed[0].probability + added)
    group = alike(best, order, elsewhere)
    if len(group) < 2:
        return (), float(weighed[0].probability)
    listed = group[:LARGEST_CLASS]
    singles = [r for r in weighed if len(r.candidate.effects) == 1 and r.candidate.effects[0] in listed]
    return (group,), float(sum(r.probability for r in singles))


def supported(probability: float, support: float) -> float:
    """Probability of an explanation after unseen data contradicted it; data in favour of it favour its rivals, too.

    ``support`` is the log likelihood ratio of explanation and plain twin on the unseen data.

    >>> supported(0.9, 3.0), round(supported(0.9, -TEMPERATURE * math.log(9.0)), 3), supported(1.0, -1e9)
    (0.9, 0.5, 0.0)
    """
    if support >= 0:
        return probability
    odds = math.exp(support / TEMPERATURE)
    return probability * odds / (probability * odds + max(1 - probability, LEAST_RIVALS))
