"""From fitted explanations to a verdict: an effect, several, none of these, or no gap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.gap.candidates import Candidate
from service.gap.evidence import log_evidence, probabilities

DETECTED = 8.0
"""Log evidence by which an effect must beat the plain twin: one false alarm in some thousand clean rigs, were
the noise Gaussian, with some 25 candidates tried."""
UNEXPLAINED = 0.25
"""Share of the gap that may be left by another law of the same effect; more is something else."""
MIXED = 0.02
"""Share of the gap that a first effect must leave for a second one, of another kind, to be looked for."""
VISIBLE = 1.5
"""J on the unseen sweep from which there is a gap that could be closed."""
ALIKE = 0.03
"""Probability, relative to the best, from which a candidate counts as not told apart."""


@dataclass(frozen=True)
class Ranked:
    """An explanation with its evidence and probability."""

    candidate: Candidate
    log_evidence: float
    probability: float
    unexplained: float
    """share of the plain twin's excess chi-square that is left"""


@dataclass(frozen=True)
class Verdict:
    """What the gap is. ``kind``: "effect", "effects", "no_gap" or "none_of_these"."""

    kind: str
    effects: tuple[str, ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    probability: float
    reasons: tuple[str, ...]


def noise_level(null: Candidate, candidates: Sequence[Candidate]) -> float:
    """Chi-square that a right twin would leave: no more than one per residual, no more than the best fit has."""
    best = min(c.fit.chi_square for c in (null, *candidates))
    return float(min(null.fit.n_residuals, best))


def ranked(null: Candidate, candidates: Sequence[Candidate]) -> list[Ranked]:
    """Explanations by falling evidence, the plain twin (no effects) among them."""
    noise = noise_level(null, candidates)
    everything = [null, *candidates]
    logs = np.array([log_evidence(c.fit.chi_square, c.fit.penalty, c.occam, noise) for c in everything])
    p = probabilities(logs)
    before = max(null.fit.chi_square + null.fit.penalty - noise, 1e-9)
    out = [
        Ranked(c, float(log), float(q), float((c.fit.chi_square + c.fit.penalty - noise) / before))
        for c, log, q in zip(everything, logs, p, strict=True)
    ]
    return sorted(out, key=lambda r: -r.log_evidence)


def alike(best: Ranked, order: Sequence[Ranked]) -> tuple[str, ...]:
    """Single effects that the data cannot tell from the best one, the best first."""
    return tuple(
        r.candidate.effects[0]
        for r in order
        if len(r.candidate.effects) == 1 and r.log_evidence > best.log_evidence + np.log(ALIKE)
    )


def decide(
    order: Sequence[Ranked], closures: Mapping[tuple[str, ...], float], remaining: float, unseen_before: float
) -> Verdict:
    """Verdict from ranked explanations.

    Parameters
    ----------
    closures : closure on the unseen sweep, by effects
    remaining : significance (normal deviate) of what the best explanation leaves
    unseen_before : J of the plain twin on the unseen sweep, 1 for noise; closure means nothing where it is small
    """
    null = next(r for r in order if not r.candidate.effects)
    best = order[0]
    gain = best.log_evidence - null.log_evidence
    if gain < DETECTED:
        if remaining > 8.0 and unseen_before > VISIBLE:
            return Verdict("none_of_these", (), (), 0.9, ("no effect of the catalogue explains any of the gap",))
        return Verdict("no_gap", (), (), float(1 / (1 + np.exp(gain - DETECTED))), ())
    effects = best.candidate.effects
    closure = closures.get(effects, 0.0) if unseen_before > VISIBLE else 1 - best.unexplained
    if remaining > 6.0 and (best.unexplained > UNEXPLAINED or closure < 1 - 1.2 * UNEXPLAINED):
        share = max(best.unexplained, 1 - closure)
        reason = f"the best explanation, {' + '.join(effects)}, leaves {100 * share:.0f} % of the gap"
        return Verdict("none_of_these", (), (), float(min(0.99, 0.5 + share)), (reason,))
    group = alike(best, order) if len(effects) == 1 else ()
    classes = (group,) if len(group) > 1 else ()
    same = [r for r in order if len(r.candidate.effects) == len(effects)]
    p = probabilities(np.array([r.log_evidence for r in same]))
    return Verdict("effect" if len(effects) == 1 else "effects", effects, classes, float(p[0]), ())
