"""Flexible modes damped otherwise than the datasheet says."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from sim.effect import Effect, Parameter, has_modes
from sim.errors import EffectError
from sim.rig import FlexibleMode, Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if not any(rig.rotor.modes):
        raise EffectError(f"effect modal_damping needs a flexible mode; the rotor of rig {rig.name} has none")
    log_ratios = (p["mode1_log_ratio"], p["mode2_log_ratio"])

    def damped(modes: tuple[FlexibleMode, ...]) -> tuple[FlexibleMode, ...]:
        changed = (
            replace(m, damping_ratio=m.damping_ratio * math.exp(v)) for m, v in zip(modes, log_ratios, strict=False)
        )
        return (*changed, *modes[2:])

    return replace(rig, rotor=replace(rig.rotor, modes=tuple(damped(m) for m in rig.rotor.modes)))


EFFECT = Effect(
    id="modal_damping",
    path="plant",
    parameters=(
        Parameter("mode1_log_ratio", "1", -3.0, 3.5, 1.1, 0.0, description="ln of the ratio of damping, first mode"),
        Parameter(
            "mode2_log_ratio",
            "1",
            -3.0,
            3.5,
            1.1,
            0.0,
            description="ln of the ratio of damping, second mode; not used on a rig with one",
            needs=partial(has_modes, number=2),
        ),
    ),
    apply=_apply,
    law="zeta_k exp(v_k) of the first two modes",
    signature="height and width of the peaks of y/i, nothing between them",
    aliases=("internal_damping",),
    separated_by="speed: damping of the shaft itself takes from the forward whirl, damping outside gives to both",
    source="Ewins, Modal Testing, 2nd ed., Research Studies Press 2000, chapter 2",
)
