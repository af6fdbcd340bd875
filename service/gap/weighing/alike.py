"""Alias classes: effects that the data cannot distinguish from those of the best explanation."""

from __future__ import annotations

from collections.abc import Sequence

from service.gap.fitting.candidates import LAW_ERROR
from service.gap.weighing.ranking import Ranked, beyond_chance, noise_levels
from sim.effects import aliases

ALIKE_LOG_EVIDENCE = 6.0
"""Log evidence behind the best up to which a candidate counts as not distinguished."""
NEITHER_LAW = 0.25
"""Share of what the best leaves beyond noise by which a known alias may leave more and is not distinguished either: of
neither is the law right, and which one the error of it suits better says little. Of currents that lag as in a slab, by
a ladder of five poles, a delay left 9.8 % and the lag of a slab 10.8 %."""


def alike(best: Ranked, order: Sequence[Ranked], elsewhere: Sequence[Ranked] = ()) -> tuple[str, ...]:
    """Single effects that the data cannot distinguish from the best one, the best first.

    A known alias of about the same cost counts, too, even if its evidence is lower: the number of its law's parameters
    says little of how likely it is. The difference may be what the error of the best one's own law could make. Example:
    a large resonance shows that bearings and sensors move by the same amplitudes to better than two programs agree, as
    they do with a resonant housing.
    """
    name = best.candidate.effects[0]
    null = next(r.candidate.fit for r in order if not r.candidate.effects)
    cost = best.candidate.fit.cost
    left = beyond_chance(best.candidate, noise_levels(best.candidate, [r.candidate for r in order]))
    margin = max(2 * ALIKE_LOG_EVIDENCE, LAW_ERROR**2 * (null.cost - cost), NEITHER_LAW * left)

    def close(r: Ranked) -> bool:
        other = r.candidate.effects[0]
        if r.log_evidence > best.log_evidence - ALIKE_LOG_EVIDENCE:
            return True
        return aliases(name, other) and r.candidate.fit.cost < cost + margin

    near = [r for r in order if len(r.candidate.effects) == 1 and close(r)]
    near += [r for r in elsewhere if r.log_evidence > best.log_evidence - ALIKE_LOG_EVIDENCE]
    near.sort(key=lambda r: (r is not best, -r.log_evidence))
    return tuple(dict.fromkeys(r.candidate.effects[-1] for r in near))


def alike_beside(best: Ranked, order: Sequence[Ranked]) -> tuple[tuple[tuple[str, ...], ...], float]:
    """Alias classes of a mixture's effects, and the probability of the mixtures with an alias in place of one effect.

    Each class has the best mixture's effect first.
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
