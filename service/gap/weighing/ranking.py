"""Fitted explanations in the order of their evidence, and what each leaves of the gap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.evidence import log_evidence, probabilities
from sim.effects import CATALOGUE

LOG_EVIDENCE_PER_EFFECT = 5.0
"""Log evidence by which an effect must beat the plain twin, some 25 candidates being tried: in 134 parts of rigs of an
independent program that had no effect there, the largest advantage by chance was 2.2, with a tail like exp(-x)."""
CLEAR_CHI_SQUARE = 30.0
"""Excess chi-square of a group from which the share that an explanation leaves of it means something."""
Groups = Sequence[tuple[float, int]]
"""(chi-square, number of residuals) each"""


@dataclass(frozen=True, eq=False)
class Ranked:
    """An explanation with its evidence and probability."""

    candidate: Candidate
    log_evidence: float
    """`LOG_EVIDENCE_PER_EFFECT` taken off for every effect: an effect is named only for good reason"""
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


def noise_levels(null: Candidate, candidates: Sequence[Candidate]) -> list[float]:
    """Chi-square of each group that a right twin leaves: no more than one per residual, nor than the best fit has."""
    return _levels([c.fit.groups for c in (null, *candidates)])


def _levels(groups: Sequence[Groups]) -> list[float]:
    return [float(min(one[0][1], *(chi for chi, _ in one))) for one in zip(*groups, strict=True)]


def ranked(null: Candidate, candidates: Sequence[Candidate]) -> list[Ranked]:
    """Explanations by falling evidence, the plain twin (no effects) among them."""
    noise = noise_levels(null, candidates)
    everything = [null, *candidates]
    logs = np.array(
        [log_evidence(c.fit, c.occam, noise) - LOG_EVIDENCE_PER_EFFECT * len(c.effects) for c in everything]
    )
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
        clear = before - level > CLEAR_CHI_SQUARE
        out.append(float(max(after - level, 0.0) / (before - level)) if clear else 0.0)
    return tuple(out)
