"""What a rig says of the effects that its twin names: whether it shows them, as named.

An effect that was added to a twin may be repaired on the rig: a delay by new firmware, a housing by a bolt. No effect
of the catalogue removes it from the twin, and others would be named for it. And its law in the twin is hardly the rig's
to the last digit: what another law of the same effect leaves is a small share of a gap that the twin without it has,
but all of the gap that the twin with it has, so that by itself it would be named as one more effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from service.gap.diagnosis import Diagnosis
from service.gap.weighing.ranking import LOG_EVIDENCE_PER_EFFECT
from service.gap.weighing.shrinkage import shrinkage
from service.gap.weighing.verdict import MIXTURE_SHARE, Verdict
from service.gap.which.mixtures import ANOTHER_LAW
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE
from sim.wording import in_words

MOST = 0.5
"""Share of what a twin leaves from which the same effects with other values explain most of it: they changed."""


def twins_without_effects(datasheet: Datasheet) -> Iterator[tuple[tuple[str, ...], Datasheet]]:
    """(effects left out, the twin without them), for each effect of the twin and for all of them."""
    names = tuple(dict.fromkeys(name for name, _ in datasheet.effects))
    for without in dict.fromkeys((*((name,) for name in names), names)):
        kept = tuple((name, values) for name, values in datasheet.effects if name not in without)
        yield without, replace(datasheet, effects=kept)


def judged_without(d: Diagnosis, without: Mapping[tuple[str, ...], Diagnosis]) -> tuple[Verdict, Diagnosis] | None:
    """A verdict on the twin's own effects, and the diagnosis without some of them that it follows from.

    None where the twin as it is explains the rig better. Else it is out of date; or has no gap, where the rig's
    explanation without effects of the twin is just these and leaves what the twin leaves: the error of their law.

    Parameters
    ----------
    d
        The diagnosis of the twin as it is.
    without
        Those of the twin without some of its effects, by the effects left out.
    """
    explained = {names: other for names, other in without.items() if other.verdict.kind != "none_of_these"}
    by_price = sorted(explained.items(), key=lambda one: _price(*one))
    better = [(names, other) for names, other in by_price if _likelier(names, other, d)]
    fewer = [(names, other) for names, other in better if len(other.verdict.effects) < len(names)]
    confirming = ((names, other) for names, other in by_price if _as_named(d, names, other))
    if not fewer and (found := next(confirming, None)):
        return _confirmed(found[0], found[1]), found[1]
    return (_outdated(*better[0]), better[0][1]) if better else None


def _as_named(d: Diagnosis, names: tuple[str, ...], other: Diagnosis) -> bool:
    """Whether the rig shows effects as the twin names them, and what is left is no more than the error of their law.

    Without them they are what explains the rig. With values of their own they come hardly nearer than those of the twin
    do, which leave no more than another law of them may, in a part of the loop that they act in. What one effect more
    would be named for is then left, too, when they are found on the plain twin.
    """
    acts_in = {CATALOGUE[name].path for name in names}
    if d.observation.I is None and "amplifier" in acts_in:
        acts_in.add("plant")  # the amplifiers are in one with it
    if set(other.verdict.effects) != set(names) or d.where.path not in acts_in:
        return False
    # as much as another program's law of them may leave: more where it is nonlinear
    allowed = ANOTHER_LAW if any(CATALOGUE[name].nonlinear for name in names) else MIXTURE_SHARE
    plain, twin, refitted = other.null.fit.rig, d.null.fit.rig, other.chosen.fit.rig
    for o in (d.observation, d.held_out):
        added, changed = (shrinkage(*rigs, o, "").closure for rigs in ((plain, twin), (twin, refitted)))
        if (added is not None and added < 1 - allowed) or (changed is not None and changed > MOST):
            return False
    return True


def _confirmed(names: tuple[str, ...], best: Diagnosis) -> Verdict:
    """No gap: what is left is the error of the law of effects that the twin names."""
    laws, come, they = ("law", "comes", "it is") if len(names) == 1 else ("laws", "come", "they are")
    reason = f"the {laws} of {_in_words(names)}, which it names, {come} no nearer where {they} fitted anew"
    return Verdict("no_gap", (), (), best.verdict.probability, (reason,))


def _outdated(names: tuple[str, ...], best: Diagnosis) -> Verdict:
    """The twin is out of date: without effects that it names it explains the rig better."""
    left = _in_words(best.verdict.effects)
    what = f"what differs is {left}" if left else f"the twin explains the rig to {100 * best.gap_before:.2g} %"
    sections, them = " and ".join(f"effects.{name}" for name in names), "it" if len(names) == 1 else "them"
    reason = (
        f"the twin names {_in_words(names)}, which the rig does not show as named: without {them} {what}; take "
        f"{sections} out of the twin{' and diagnose again' if left else ''}"
    )
    path = CATALOGUE[names[0]].path
    return Verdict(
        "none_of_these",
        (),
        (),
        best.verdict.probability,
        (reason,),
        unexplained="plant" if path == "additive" else path,
        outdated=names,
    )


def what_is_left(effects: Sequence[str]) -> str:
    """A note on what a twin whose effects are confirmed leaves, which by itself would be named ``effects``."""
    looks = f"looks like {_in_words(effects)}" if effects else "no known effect explains"
    return f"what little is left {looks}"


def _price(names: tuple[str, ...], other: Diagnosis) -> tuple[int, int, float]:
    """Sort key of a twin without effects: fewest effects in all, then fewest left out, then the most evidence."""
    return len(other.verdict.effects) - len(names), len(names), -_evidence(other)


def _likelier(names: tuple[str, ...], best: Diagnosis, d: Diagnosis) -> bool:
    """Whether the twin without effects explains the rig better than the twin as it is.

    By evidence where both were fitted to the same sweeps. Otherwise evidence cannot be compared: then it must need
    fewer effects in all, or the twin as it is explain nothing.
    """
    if len(best.null.fit.groups) == len(d.null.fit.groups):
        return _evidence(best) > _evidence(d) + LOG_EVIDENCE_PER_EFFECT
    return _price(names, best)[0] < len(d.verdict.effects) or d.verdict.kind == "none_of_these"


def _in_words(names: Iterable[str]) -> str:
    return " and ".join(map(in_words, names))


def _evidence(d: Diagnosis) -> float:
    """Log evidence of the explanation that a diagnosis names, or else of its best one."""
    named = (r.log_evidence for r in d.order if r.candidate.effects == d.verdict.effects and d.verdict.effects)
    plain = (r.log_evidence for r in d.order if not r.candidate.effects and d.verdict.kind == "no_gap")
    return next(named, next(plain, d.order[0].log_evidence))
