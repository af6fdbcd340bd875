"""A voltage limit that only shows by amplifiers whose current loop is lost at the steepest current asked of them.

Such an erratic point has no amplitude to fit, and all others may be as without a limit. So the limit lies above the
steepest current that was followed, and below what was asked for where the loop was lost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.gap.compose import Composition
from service.gap.fitting.nuisance import Nuisance
from service.gap.measured.erratic import Erratic
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import Verdict
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model

LIMIT = "amplifier_voltage_limit"
SLEW_INVERSE = "slew_inverse_s_per_a"
PROBABILITY_OF_A_LIMIT = 0.9
"""Probability that it is a voltage limit: on 250 sweeps of another program nothing else made two axes erratic at
once."""
LEAST_WIDTH = 0.1
"""Least relative width of the interval that holds the limit: amplifiers lose their loop a little above it."""


@dataclass(frozen=True)
class LostLoop:
    """Where amplifiers lose their loop, in words, and an interval of slew limits that holds theirs, A/s.

    The interval is None where currents as steep were followed elsewhere, so that the slope is not the cause.
    """

    words: str
    between_a_per_s: tuple[float, float] | None

    @classmethod
    def of(cls, erratic: Erratic, rig: Rig) -> LostLoop:
        """From erratic points; the current asked for there is that of ``rig`` in small-signal operation."""
        s = erratic.points
        m = linear_model(rig, s.frequency_hz)
        R = s.R[:, :, s.harmonics.index(1)].mean(axis=1)
        I = np.einsum("pij,pjk,pk->pi", m.i_per_u, m.u_per_r, R)
        asked = float((2 * np.pi * s.frequency_hz * np.abs(I[np.arange(s.n_points), s.axis])).min())
        followed = erratic.steepest_a_per_s
        if asked < followed:
            return cls(erratic.words, None)
        middle = np.sqrt(asked * followed)
        half = max(np.sqrt(asked / followed), 1 + LEAST_WIDTH / 2)
        return cls(erratic.words, (float(middle / half), float(middle * half)))


def named_limit(verdict: Verdict, lost: LostLoop) -> Verdict:
    """The verdict with the limit added, unless it is none of these, or names a possible cause of the erratic points.

    Such a cause is an effect that is nonlinear or of the amplifiers.
    """
    may_cause_it = any(CATALOGUE[name].nonlinear or CATALOGUE[name].path == "amplifier" for name in verdict.effects)
    if lost.between_a_per_s is None or verdict.kind == "none_of_these" or may_cause_it:
        return verdict
    effects = (*verdict.effects, LIMIT)
    kind = "effect" if len(effects) == 1 else "effects"
    return replace(verdict, kind=kind, effects=effects, probability=PROBABILITY_OF_A_LIMIT * verdict.probability)


def with_limit(whole: Composition, nuisance: Nuisance, lost: LostLoop) -> Composition:
    """The twins with their voltage limit set from where the loop was lost, as fits only know that it is not lower."""
    if lost.between_a_per_s is None:
        return whole
    low, high = lost.between_a_per_s
    value, relative_sd = 1 / np.sqrt(low * high), float(np.log(high / low) / np.sqrt(12))

    def limited(r: Ranked) -> Ranked:
        c = r.candidate
        if LIMIT not in c.effects:
            return r
        # the limit last, as in the verdict, though its part may have the larger gap
        order = sorted(range(len(c.effects)), key=lambda k: c.effects[k] == LIMIT)
        effects = tuple(c.effects[k] for k in order)
        values, deviations = ([dict(of[k]) for k in order] for of in (c.fit.values, c.standard_deviations))
        values[-1][SLEW_INVERSE], deviations[-1][SLEW_INVERSE] = float(value), float(value * relative_sd)
        rig = nuisance.at(c.fit.theta)
        for name, own in zip(effects, values, strict=True):
            rig = CATALOGUE[name].on(rig, **own)
        ends = {of: end for of, end in c.fit.ends.items() if of != (LIMIT, SLEW_INVERSE)}
        fit = replace(c.fit, effects=effects, values=tuple(values), rig=rig, ends=ends)
        # its strength is known from points that were not fitted
        still_open = tuple(name for name in r.open_strength if name != LIMIT)
        twin = replace(c, effects=effects, fit=fit, standard_deviations=tuple(deviations))
        return replace(r, candidate=twin, open_strength=still_open)

    return Composition(tuple(limited(r) for r in whole.order))
