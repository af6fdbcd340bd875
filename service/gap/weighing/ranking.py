"""Fitted explanations ranked by evidence, with the share of the gap that each leaves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.evidence import log_evidence, probabilities
from sim.effects import CATALOGUE

LOG_EVIDENCE_PER_EFFECT = 5.0
"""Log evidence by which an effect must beat the plain twin, as some 25 candidates are tried: in 134 parts of rigs of an
independent program that had no effect there, the largest lead by chance was 2.2, with a tail like exp(-x)."""
CLEAR_CHI_SQUARE = 30.0
"""Excess chi-square of the plain twin in a group from which the share that is left of it is meaningful."""
CHANCE = 3.0
"""Standard deviations of a chi-square up to which nothing is left of a gap."""
Groups = Sequence[tuple[float, int]]
"""(chi-square, number of residuals) each"""


@dataclass(frozen=True, eq=False)
class Ranked:
    """An explanation with its evidence and probability."""

    candidate: Candidate
    log_evidence: float
    """less `LOG_EVIDENCE_PER_EFFECT` for every effect"""
    probability: float
    unexplained: float
    """share of the gap (the plain twin's excess cost) that is left"""
    shares: tuple[float, ...] = ()
    """the same for the fundamental and for the harmonics of each sweep in turn (`Fit.groups`); 0 where there was no
    gap"""
    across: tuple[float, ...] = ()
    """the same for the fundamental in the plane that was not excited, for each sweep (`Fit.across`)"""
    open_strength: tuple[str, ...] = ()
    """nonlinear effects without which the fitted data are as likely: their strength at larger amplitudes is unknown"""

    @property
    def apart(self) -> tuple[float, ...]:
        """Shares of all groups: `shares` and `across`, where a coupling of the planes shows best."""
        return (*self.shares, *self.across)


def noise_levels(null: Candidate, candidates: Sequence[Candidate]) -> list[float]:
    """Chi-square of each group that a right twin leaves: one per residual, or that of the best fit where it is less."""
    return _levels([c.fit.groups for c in (null, *candidates)])


def _levels(groups: Sequence[Groups]) -> list[float]:
    """The noise level of each group from those of all fits."""
    return [float(min(one[0][1], *(chi for chi, _ in one))) for one in zip(*groups, strict=True)]


def beyond_chance(c: Candidate, levels: Sequence[float]) -> float:
    """Chi-square that an explanation leaves in all groups beyond what noise of these ``levels`` would by chance."""
    left = (chi - level - CHANCE * np.sqrt(2 * level) for (chi, _), level in zip(c.fit.groups, levels, strict=True))
    return sum(max(float(excess), 0.0) for excess in left)


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
    """Nonlinear effects of an explanation without which one of its remaining effects has as much evidence.

    A linear effect that does not show is as small on any other sweep, so it is not listed.
    """
    evidence_of = [(set(c.effects), other) for c, other in zip(everything, logs, strict=True)]

    def without(effect: str) -> float:
        rest = set(candidate.effects) - {effect}
        return max(other for effects, other in evidence_of if effects <= rest)

    nonlinear = (effect for effect in candidate.effects if CATALOGUE[effect].nonlinear)
    return tuple(effect for effect in nonlinear if without(effect) >= log)


def renormalised(order: Sequence[Ranked]) -> list[Ranked]:
    """The explanations with their probabilities normalised over these alone."""
    p = probabilities(np.array([r.log_evidence for r in order]))
    return [replace(r, probability=float(q)) for r, q in zip(order, p, strict=True)]


def unexplained(candidate: Candidate, null: Candidate, noise: Sequence[float]) -> float:
    """Share of the plain twin's excess cost, chi-square beyond noise and penalty, that an explanation leaves."""
    before = max(null.fit.cost - sum(noise), 1e-9)
    return float((candidate.fit.cost - sum(noise)) / before)


def shares(groups: Groups, null: Groups, noise: Sequence[float]) -> tuple[float, ...]:
    """Share of the plain twin's excess chi-square that is left, by group; 0 where its excess is not clear."""
    out = []
    for (after, _), (before, _), level in zip(groups, null, noise, strict=True):
        clear = before - level > CLEAR_CHI_SQUARE
        out.append(float(max(after - level, 0.0) / (before - level)) if clear else 0.0)
    return tuple(out)
