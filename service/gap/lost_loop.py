"""Amplifiers that lose their loop at the steepest current that is asked of them: a voltage limit that no fit sees.

Such a point has no amplitude to fit, and every other one may be as if there were no limit. That tells where it lies:
above the steepest current that was followed, and below what was asked for where the loop was lost.
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
"""Probability that it is one: on 250 sweeps of another program nothing else made amplifiers of two axes erratic."""
LEAST_WIDTH = 0.1
"""Relative width within which the limit is never taken to be known: amplifiers lose their loop a little above it."""


@dataclass(frozen=True)
class LostLoop:
    """Where amplifiers lose their loop, in words, and the slew limits between which theirs lies, A/s.

    None for the limits where currents as steep were followed elsewhere: then it is not the slope.
    """

    words: str
    between_a_per_s: tuple[float, float] | None

    @classmethod
    def of(cls, erratic: Erratic, rig: Rig) -> LostLoop:
        """From erratic points; what was asked for there is what ``rig``, its magnets linear, would have answered."""
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
    """The verdict with the limit beside its effects, unless it has none of these, or one that would do the same.

    What grows with amplitude, or is of the amplifiers, may be the reason itself.
    """
    may_be = any(CATALOGUE[name].nonlinear or CATALOGUE[name].path == "amplifier" for name in verdict.effects)
    if lost.between_a_per_s is None or verdict.kind == "none_of_these" or may_be:
        return verdict
    effects = (*verdict.effects, LIMIT)
    kind = "effect" if len(effects) == 1 else "effects"
    return replace(verdict, kind=kind, effects=effects, probability=PROBABILITY_OF_A_LIMIT * verdict.probability)


def with_limit(whole: Composition, nuisance: Nuisance, lost: LostLoop) -> Composition:
    """The same twins, their voltage limit where the loop was lost: their fits know only that it is above the rest."""
    if lost.between_a_per_s is None:
        return whole
    low, high = lost.between_a_per_s
    value, spread = 1 / np.sqrt(low * high), float(np.log(high / low) / np.sqrt(12))

    def limited(r: Ranked) -> Ranked:
        c = r.candidate
        if LIMIT not in c.effects:
            return r
        # last, as the verdict names it: its part may have the larger gap
        last = sorted(range(len(c.effects)), key=lambda k: c.effects[k] == LIMIT)
        effects = tuple(c.effects[k] for k in last)
        values, deviations = ([dict(of[k]) for k in last] for of in (c.fit.values, c.standard_deviations))
        values[-1][SLEW_INVERSE], deviations[-1][SLEW_INVERSE] = float(value), float(value * spread)
        rig = nuisance.at(c.fit.theta)
        for name, own in zip(effects, values, strict=True):
            rig = CATALOGUE[name].on(rig, **own)
        ends = {of: end for of, end in c.fit.ends.items() if of != (LIMIT, SLEW_INVERSE)}
        fit = replace(c.fit, effects=effects, values=tuple(values), rig=rig, ends=ends)
        # the points that tell it are none that a fit has weighed
        known = tuple(name for name in r.open_strength if name != LIMIT)
        twin = replace(c, effects=effects, fit=fit, standard_deviations=tuple(deviations))
        return replace(r, candidate=twin, open_strength=known)

    return Composition(tuple(limited(r) for r in whole.order))
