"""Which two explanations an experiment should separate: of one alias class, else of nearly the same evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.part import STANDSTILL
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.verdict import Verdict
from sim.effects import CATALOGUE
from sim.rig import FlexibleMode, Rig

NEARLY = 5.0
"""Log evidence behind the chosen explanation up to which another one is a rival: as much as an effect costs."""


def pair_to_separate(order: Sequence[Ranked], verdict: Verdict) -> tuple[Candidate, Candidate] | None:
    """The chosen explanation and the rival it is to be separated from; None where there is none.

    An explanation that adds effects to the chosen one is no rival.
    """
    chosen = next((r for r in order if r.candidate.effects == verdict.effects and r.candidate.effects), None)
    if verdict.kind not in ("effect", "effects") or chosen is None:
        return None
    c = chosen.candidate
    by_effects = {frozenset(r.candidate.effects): r.candidate for r in order}
    for group in verdict.indistinguishable:
        named = next((name for name in group if name in c.effects), None)
        for other in group:
            if named is None or other == named:
                continue
            instead = by_effects.get(frozenset({*c.effects, other} - {named}))
            if instead is None and STANDSTILL.get(named) == other:
                instead = turning_with_the_shaft(c)
            if instead is not None:
                return c, instead
    fitted = {name for name in c.effects if CATALOGUE[name].path != "additive"}  # interference was found in the noise
    for r in order:
        effects = set(r.candidate.effects)
        if effects and not effects >= fitted and r.log_evidence > chosen.log_evidence - NEARLY:
            return c, r.candidate
    return None


def in_question(order: Sequence[Ranked], verdict: Verdict) -> list[Candidate]:
    """All explanations that the verdict's alias classes leave: the chosen one with an alias in place of one effect."""
    by_effects = {frozenset(r.candidate.effects): r.candidate for r in order}
    named = set(verdict.effects)
    swapped = (named - {*group} | {other} for group in verdict.indistinguishable for other in group)
    return [by_effects[effects] for effects in dict.fromkeys(map(frozenset, swapped)) if effects in by_effects]


def turning_with_the_shaft(c: Candidate) -> Candidate | None:
    """A twin that is the same at standstill, with the damping that it has gained as internal damping.

    None where it has gained none, or more than internal damping can be.
    """
    k = c.effects.index("modal_damping")
    total = [m.damping_ratio for m in c.fit.rig.rotor.modes[0]]
    gained = [t * (1 - math.exp(-c.fit.values[k][f"mode{n + 1}_log_ratio"])) for n, t in enumerate(total) if n < 2]
    gained = [max(g, 0.0) for g in gained]
    mean = sum(gained) / len(gained)
    effect = CATALOGUE["internal_damping"]
    strength = next(p for p in effect.parameters if p.name == "damping_ratio")
    if not strength.low <= mean <= strength.high:
        return None
    own = {"damping_ratio": mean, "mode_imbalance": (gained[0] - gained[-1]) / sum(gained)}
    rig = _with_total_damping_kept(effect.on(c.fit.rig, **own), c.fit.rig)
    effects = (*c.effects[:k], effect.id, *c.effects[k + 1 :])
    values = (*c.fit.values[:k], own, *c.fit.values[k + 1 :])
    return replace(c, effects=effects, fit=replace(c.fit, effects=effects, values=values, rig=rig))


def _with_total_damping_kept(rig: Rig, before: Rig) -> Rig:
    """The rig with its external damping reduced by what it has more internal damping than ``before``."""

    def less(now: FlexibleMode, then: FlexibleMode) -> FlexibleMode:
        more = now.internal_damping_ratio - then.internal_damping_ratio
        return replace(now, damping_ratio=max(now.damping_ratio - more, 0.0))

    planes = zip(rig.rotor.modes, before.rotor.modes, strict=True)
    modes = tuple(tuple(less(*pair) for pair in zip(*of_plane, strict=True)) for of_plane in planes)
    return replace(rig, rotor=replace(rig.rotor, modes=modes))
