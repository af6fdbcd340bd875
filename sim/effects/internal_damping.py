"""Damping that turns with the shaft: joints and shrink fits."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain, islice, repeat

from sim.effect import Effect, Parameter, rarely_needed
from sim.errors import EffectError
from sim.rig import FlexibleMode, Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if not any(rig.rotor.modes):
        raise EffectError(f"effect internal_damping needs a flexible mode; the rotor of rig {rig.name} has none")
    imbalance = p["mode_imbalance"] if min(map(len, rig.rotor.modes)) > 1 else 0.0
    shares = chain((1 + imbalance, 1 - imbalance), repeat(1 - abs(imbalance)))

    own = [share * p["damping_ratio"] for share in islice(shares, max(map(len, rig.rotor.modes)))]

    def turning(modes: tuple[FlexibleMode, ...]) -> tuple[FlexibleMode, ...]:
        both = zip(modes, own, strict=False)
        return tuple(replace(m, internal_damping_ratio=m.internal_damping_ratio + more) for m, more in both)

    return replace(rig, rotor=replace(rig.rotor, modes=tuple(turning(modes) for modes in rig.rotor.modes)))


EFFECT = Effect(
    id="internal_damping",
    path="plant",
    parameters=(
        Parameter("damping_ratio", "1", 1e-5, 0.03, 2e-3, 0.0, "log", "zi, added to every flexible mode, mean of two"),
        rarely_needed(
            "mode_imbalance",
            "1",
            -1.0,
            1.0,
            0.0,
            description="1: only of the first mode, -1: only of the second; nothing on a rotor with one",
            wakes=(0.8, -0.8),
        ),
    ),
    apply=_apply,
    law="forward whirl zF = ze + zi (1 - W/w), backward zB = ze + zi (1 + W/w)",
    signature="wider peaks; at speed the forward whirl loses what the backward one gains",
    aliases=("modal_damping",),
    separated_by="speed; at standstill it is damping like any other",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapter 2 (rotating damping)",
)
