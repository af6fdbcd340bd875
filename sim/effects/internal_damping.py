"""Damping that turns with the shaft: joints and shrink fits."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.errors import EffectError
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if not any(rig.rotor.modes):
        raise EffectError(f"effect internal_damping needs a flexible mode; the rotor of rig {rig.name} has none")
    ratio = rig.rotor.internal_damping_ratio + p["damping_ratio"]
    return replace(rig, rotor=replace(rig.rotor, internal_damping_ratio=ratio))


EFFECT = Effect(
    id="internal_damping",
    path="plant",
    parameters=(Parameter("damping_ratio", "1", 1e-5, 0.03, 2e-3, 0.0, "log", "zi, added to every flexible mode"),),
    apply=_apply,
    law="forward whirl zF = ze + zi (1 - W/w), backward zB = ze + zi (1 + W/w)",
    signature="wider peaks; at speed the forward whirl loses what the backward one gains",
    aliases=("modal_damping",),
    separated_by="speed; at standstill it is damping like any other",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapter 2 (rotating damping)",
)
