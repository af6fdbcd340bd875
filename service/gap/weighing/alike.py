"""What the data cannot tell from the best explanation: its alias classes."""

from __future__ import annotations

from collections.abc import Sequence

from service.gap.fitting.candidates import LAW_ERROR
from service.gap.weighing.ranking import Ranked
from sim.effects import aliases

ALIKE_LOG_EVIDENCE = 6.0
"""Log evidence behind the best up to which a candidate counts as not told apart."""


def alike(best: Ranked, order: Sequence[Ranked], elsewhere: Sequence[Ranked] = ()) -> tuple[str, ...]:
    """Single effects that the data cannot tell from the best one, the best first.

    Known aliases that fit as well count whatever the number of their parameters: how many a law has says little
    of how likely it is. As well is what leaves no more than the error of the best one's own law would: a large effect
    shows shapes of a mode that differ by less than two programs do, and a housing has them equal.
    """
    name = best.candidate.effects[0]
    null = next(r.candidate.fit for r in order if not r.candidate.effects)
    cost = best.candidate.fit.cost
    as_well = max(2 * ALIKE_LOG_EVIDENCE, LAW_ERROR**2 * (null.cost - cost))

    def close(r: Ranked) -> bool:
        other = r.candidate.effects[0]
        if r.log_evidence > best.log_evidence - ALIKE_LOG_EVIDENCE:
            return True
        return aliases(name, other) and r.candidate.fit.cost < cost + as_well

    near = [r for r in order if len(r.candidate.effects) == 1 and close(r)]
    near += [r for r in elsewhere if r.log_evidence > best.log_evidence - ALIKE_LOG_EVIDENCE]
    near.sort(key=lambda r: (r is not best, -r.log_evidence))
    return tuple(dict.fromkeys(r.candidate.effects[-1] for r in near))


def alike_beside(best: Ranked, order: Sequence[Ranked]) -> tuple[tuple[tuple[str, ...], ...], float]:
    """Classes of a mixture's effects that known aliases could stand for beside the others, and what all of those add.

    The best one's effect first in each; the number is the probability of the mixtures that differ in one effect so.
    """
    effects, classes, added = best.candidate.effects, [], 0.0
    near = [r for r in order if r is not best and r.log_evidence > best.log_evidence - ALIKE_LOG_EVIDENCE]
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
