"""An effect that the plant seems to have and the amplifiers may have: both parts are weighed together.

The amplifiers are judged by their measured current first. Where that is noisy, a lag of theirs that hardly shows in it
is plainly seen in the displacement, and the plant would be blamed for it.
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
"""Share of the plant's gap left from which its best explanation says nothing of the amplifiers: of what no effect is
like, one effect's law takes as little as another's, and the plant would be searched twice for nothing."""

Through = Callable[[Candidate], Ground]
"""The plant's ground behind an explanation of the amplifiers."""


@dataclass(frozen=True)
class Exchange:
    """An explanation of the amplifiers by one effect more, in place of one effect of the plant."""

    amplifiers: Ranked
    kept: frozenset[str]
    """the plant's other effects"""
    log_evidence: float
    """of the plant with those alone"""


def plant_or_amplifiers(
    fitter: Fitter, amplifiers: Explained, plant: Explained, through: Through
) -> tuple[Explained, Explained]:
    """Amplifiers and plant as explained, with what would explain as well by an effect of the other part.

    Where one effect more of the amplifiers explains both parts better, they get it. The plant is returned as it was and
    has to be explained anew behind them.
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
    # a mixture that does not need all of its effects is not in the order, but those that it needs are
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
    """Every known alias in the amplifiers of an effect of the plant, with what the plant then says without that."""
    chosen, best = amplifiers.order[0].candidate, plant.order[0]
    noise = noise_levels(plant.null.candidate, [r.candidate for r in plant.order])
    for r in amplifiers.order:
        more = set(r.candidate.effects) - set(chosen.effects)
        if len(more) != 1 or not set(chosen.effects) <= set(r.candidate.effects):
            continue
        if r.log_evidence < amplifiers.order[0].log_evidence - LOG_EVIDENCE_IN_REACH:
            continue
        for name in best.candidate.effects:
            if aliases(name, next(iter(more))):
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
