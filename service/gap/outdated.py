"""A twin that is out of date: it names an effect that its rig does not have, or no longer.

An effect that was added to a twin may be repaired on the rig: a delay by new firmware, a housing by a bolt. No effect
of the catalogue removes it from the twin, and others would be named for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from service.gap.diagnosis import Diagnosis
from service.gap.weighing.ranking import LOG_EVIDENCE_PER_EFFECT
from service.gap.weighing.shrinkage import shrinkage
from service.gap.weighing.verdict import Verdict
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE
from sim.wording import in_words


def twins_without_effects(datasheet: Datasheet) -> Iterator[tuple[tuple[str, ...], Datasheet]]:
    """(effects left out, the twin without them), for each effect of the twin and for all of them."""
    names = tuple(dict.fromkeys(name for name, _ in datasheet.effects))
    for without in dict.fromkeys((*((name,) for name in names), names)):
        kept = tuple((name, values) for name, values in datasheet.effects if name not in without)
        yield without, replace(datasheet, effects=kept)


def outdated(d: Diagnosis, without: Mapping[tuple[str, ...], Diagnosis]) -> Diagnosis | None:
    """The diagnosis that a twin is out of date; None where the twin as it is explains the rig better.

    Parameters
    ----------
    d
        The diagnosis of the twin as it is.
    without
        Those of the twin without some of its effects, by the effects left out.
    """
    explained = {names: other for names, other in without.items() if other.verdict.kind != "none_of_these"}
    by_price = sorted(explained.items(), key=lambda one: _price(*one))
    found = next(((names, other) for names, other in by_price if _likelier(names, other, d)), None)
    if found is None:
        return None
    names, best = found
    left = _in_words(best.verdict.effects)
    what = f"what differs is {left}" if left else f"the twin explains the rig to {100 * best.gap_before:.2g} %"
    sections, them = " and ".join(f"effects.{name}" for name in names), "it" if len(names) == 1 else "them"
    reason = (
        f"the twin names {_in_words(names)}, which the rig does not show as named: without {them} {what}; take "
        f"{sections} out of the twin{' and diagnose again' if left else ''}"
    )
    path = CATALOGUE[names[0]].path
    verdict = Verdict(
        "none_of_these",
        (),
        (),
        best.verdict.probability,
        (reason,),
        unexplained="plant" if path == "additive" else path,
        outdated=names,
    )
    closed = shrinkage(d.null.fit.rig, best.null.fit.rig, d.held_out, d.shrinkage.held_out)
    return replace(d, verdict=verdict, shrinkage=closed, next_experiment=None, notes=best.notes)


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
