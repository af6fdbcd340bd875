"""Whether an effect of the plant is rather an alias of it in the amplifiers: both parts are compared together.

The amplifiers are explained first, by their measured current. Where that is noisy, a lag of theirs may hardly show in
it and plainly in the displacement, so that an effect of the plant would be named for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.evidence import log_evidence
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.weighing.alike import ALIKE_LOG_EVIDENCE
from service.gap.weighing.ranking import LOG_EVIDENCE_PER_EFFECT, Ranked, noise_levels, renormalised
from service.gap.which.explained import Explained
from service.gap.which.one_more_effect import residuals
from service.gap.which.refits import LOG_EVIDENCE_IN_REACH
from sim.effects import aliases

HARDLY_EXPLAINED = 0.5
"""Share of the plant's gap left from which nothing is exchanged: where no effect fits, all explain about as little, and
the plant would be searched twice for nothing."""

Through = Callable[[Candidate], Ground]
"""Candidate of the amplifiers -> the plant's ground with them."""


@dataclass(frozen=True)
class Exchange:
    """An explanation of the amplifiers by one more effect, in exchange for one effect of the plant."""

    amplifiers: Ranked
    kept: frozenset[str]
    """the plant's other effects"""
    log_evidence: float
    """of the plant with these alone, behind those amplifiers"""


def plant_or_amplifiers(
    fitter: Fitter, amplifiers: Explained, plant: Explained, through: Through
) -> tuple[Explained, Explained]:
    """Amplifiers and plant, the effect in the part where it explains both better, with its rivals of the other part.

    Where the amplifiers get one more effect, the plant is returned as it was and has to be explained again.
    """
    chosen, best = amplifiers.order[0], plant.order[0]
    if best.unexplained > HARDLY_EXPLAINED:
        return amplifiers, plant
    found = list(_exchanges(fitter, amplifiers, plant, through))
    if not found:
        return amplifiers, plant
    first = max(found, key=lambda x: x.amplifiers.log_evidence + x.log_evidence)
    if first.amplifiers.log_evidence + first.log_evidence <= chosen.log_evidence + best.log_evidence:
        rivals = (_raised(x.amplifiers, x.log_evidence - chosen.log_evidence) for x in found)
        return amplifiers, replace(plant, elsewhere=_near(rivals, best.log_evidence))
    # mixtures with a superfluous effect are not in the order, but one with fewer effects is
    without = max(r.log_evidence for r in plant.order if set(r.candidate.effects) <= first.kept)
    own = {x.amplifiers.candidate.effects: x.log_evidence for x in found if x.kept == first.kept}
    raised = [_raised(r, own.get(r.candidate.effects, without)) for r in amplifiers.order]
    order = renormalised(sorted(raised, key=lambda r: -r.log_evidence))
    rivals = (_raised(r, chosen.log_evidence) for r in plant.order if len(r.candidate.effects) == 1)
    left = residuals(amplifiers.ground, order[0].candidate)
    elsewhere = _near(rivals, order[0].log_evidence)
    return replace(amplifiers, order=tuple(order), left=left, elsewhere=elsewhere), plant


def _raised(r: Ranked, by: float) -> Ranked:
    return replace(r, log_evidence=r.log_evidence + by)


def _near(rivals: Iterable[Ranked], best: float) -> tuple[Ranked, ...]:
    return tuple(r for r in rivals if r.log_evidence > best - ALIKE_LOG_EVIDENCE)


def _exchanges(fitter: Fitter, amplifiers: Explained, plant: Explained, through: Through) -> Iterator[Exchange]:
    """Exchanges of an effect of the plant for an alias in the amplifiers, with the plant fitted without that effect."""
    chosen, best = amplifiers.order[0].candidate, plant.order[0]
    noise = noise_levels(plant.null.candidate, [r.candidate for r in plant.order])
    for r in amplifiers.order:
        added = set(r.candidate.effects) - set(chosen.effects)
        if len(added) != 1 or not set(chosen.effects) <= set(r.candidate.effects):
            continue
        if r.log_evidence < amplifiers.order[0].log_evidence - LOG_EVIDENCE_IN_REACH:
            continue
        for name in best.candidate.effects:
            if aliases(name, next(iter(added))):
                tasks = [_without(name, best.candidate, through(r.candidate))]
                for c in fitter.run(tasks):
                    own = log_evidence(c.fit, c.occam, noise) - LOG_EVIDENCE_PER_EFFECT * len(c.effects)
                    yield Exchange(r, frozenset(c.effects), own)


def _without(name: str, c: Candidate, ground: Ground) -> Task:
    """Task to fit an explanation without one of its effects on another ground."""
    kept = [k for k, effect in enumerate(c.effects) if effect != name]
    theta, own = ground.theta.copy(), ground.part.active
    theta[own] = c.fit.theta[own]
    return Task(ground, tuple(c.effects[k] for k in kept), (tuple(c.fit.values[k] for k in kept),), theta, (EXACT,))
