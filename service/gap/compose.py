"""Whole twins composed of the parts' explanations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fitted import Fit
from service.gap.fitting.nuisance import Nuisance
from service.gap.weighing.ranking import Ranked
from service.gap.which.explained import Explained
from sim.effect import End
from sim.effects import CATALOGUE

Complex = NDArray[np.complex128]

LISTED = 12
"""Number of a part's best explanations that are combined with the chosen ones of the other parts."""


@dataclass(frozen=True)
class Composition:
    """Whole twins by falling evidence, the plain twin among them."""

    order: tuple[Ranked, ...]

    @property
    def null(self) -> Ranked:
        """The plain twin."""
        return next(r for r in self.order if not r.candidate.effects)


def composed(nuisance: Nuisance, found: Sequence[Explained]) -> Composition:
    """Twins of the chosen explanations, of every alternative in one part, of effects in one part alone, and of none."""
    chosen = [next(r for r in e.order if r.candidate is e.chosen) for e in found]
    by_size = sorted(range(len(found)), key=lambda k: -excess_of(found[k]))
    picks = [list(chosen), [e.null for e in found]]
    for k, e in enumerate(found):
        picks += [[r if j == k else c for j, c in enumerate(chosen)] for r in e.order[:LISTED]]
        picks.append([c if j == k else found[j].null for j, c in enumerate(chosen)])
    whole: dict[tuple[str, ...], Ranked] = {}
    before = max(sum(excess_of(e) for e in found), 1e-9)
    for pick in picks:
        combined = _combined(nuisance, found, pick, by_size)
        left = sum(r.unexplained * excess_of(e) for r, e in zip(pick, found, strict=True)) / before
        evidence = sum(r.log_evidence for r in pick)
        probability = float(np.prod([r.probability for r in pick]))
        open_strength = tuple(name for r in pick for name in r.open_strength)
        whole.setdefault(combined.effects, Ranked(combined, evidence, probability, left, open_strength=open_strength))
    return Composition(tuple(sorted(whole.values(), key=lambda r: -r.log_evidence)))


def excess_of(e: Explained) -> float:
    """Cost of the plain twin of a part beyond that of the best fit."""
    best = min(r.candidate.fit.cost for r in e.order)
    return max(e.null.candidate.fit.cost - best, 0.0)


def _combined(
    nuisance: Nuisance, found: Sequence[Explained], pick: Sequence[Ranked], by_size: Sequence[int]
) -> Candidate:
    """One candidate made of one explanation per part (``pick``), effects of the part with the largest gap first.

    The plant may have refitted the amplifiers' values (`Ground.inherited`): if it did so with the amplifiers'
    explanation that is picked, its values count, else those of the amplifiers' own fit.
    """
    theta, k = np.zeros(len(nuisance)), len(nuisance)
    curvature = np.zeros((k, k))
    refitted: dict[str, Mapping[str, float]] = {}
    ends: dict[tuple[str, str], End] = {}
    amplifiers = next((r.candidate.effects for e, r in zip(found, pick, strict=True) if e.part.path == "amplifier"), ())
    for e, r in zip(found, pick, strict=True):  # in the order of fitting, so that a later fit overrides an earlier one
        fit, other = r.candidate.fit, e.ground.inherited
        active, effects = fit.active, {*fit.effects}
        if other is not None and other.of == amplifiers:
            refitted |= {name: values for (name, _), values in zip(other.effects, fit.inherited, strict=True)}
            effects |= {*refitted}
        else:
            active = e.ground.part.active
        theta[active] = fit.theta[active]
        curvature[np.ix_(active, active)] += fit.curvature[: len(active), : len(active)]
        ends = {of: end for of, end in ends.items() if of[0] not in effects}
        ends |= {of: end for of, end in fit.ends.items() if of[0] in effects}
    named = [
        (name, refitted.get(name, values), sds)
        for r in (pick[n] for n in by_size)
        for name, values, sds in zip(
            r.candidate.effects, r.candidate.fit.values, r.candidate.standard_deviations, strict=True
        )
    ]
    rig = nuisance.at(theta)
    for name, values, _ in named:
        rig = CATALOGUE[name].on(rig, **values)
    fit = Fit(
        tuple(name for name, _, _ in named),
        theta,
        tuple(dict(values) for _, values, _ in named),
        rig,
        tuple(g for r in pick for g in r.candidate.fit.groups),
        float(theta @ theta),
        np.arange(k),
        curvature,
        "; ".join(sorted({r.candidate.fit.status for r in pick})),
        ends=ends,
    )
    return Candidate(fit.effects, fit, sum(r.candidate.occam for r in pick), tuple(sds for _, _, sds in named))
