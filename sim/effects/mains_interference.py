"""Hum of the mains on sensors and current probes."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.rig import Disturbance, Rig

HARMONICS = {1: 1.0, 2: 0.3, 3: 0.5, 5: 0.2}
"""Relative amplitude of each multiple of the mains frequency: odd ones lead, as with rectifiers."""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    axis, mains = np.arange(rig.n_axes, dtype=float), p["frequency_hz"]
    added = tuple(
        Disturbance(target, np.full_like(axis, share * p[name]), 0.7 * k * axis, fixed_hz=k * mains)
        for target, name in (("y", "amplitude_m"), ("i", "amplitude_a"))
        for k, share in HARMONICS.items()
        if p[name]
    )
    return replace(rig, disturbances=(*rig.disturbances, *added))


EFFECT = Effect(
    id="mains_interference",
    path="additive",
    parameters=(
        Parameter("amplitude_m", "m", 1e-9, 1e-3, 2e-7, 0.0, "log", "at the mains frequency on every sensor"),
        Parameter("amplitude_a", "A", 1e-5, 100.0, 1e-2, 0.0, "log", "at the mains frequency on every current probe"),
        Parameter(
            "frequency_hz", "Hz", 45.0, 400.0, 50.0, 50.0, description="of the mains or its rectifier", strength=False
        ),
    ),
    apply=_apply,
    law="+ a_k cos(2 pi k f t + phi_k), k = 1, 2, 3, 5",
    signature="lines at fixed frequencies, not in proportion to the excitation; near them phase drifts block by block",
    aliases=("runout",),
    separated_by="a record without excitation; another speed",
    source="Ott, Electromagnetic Compatibility Engineering, Wiley 2009, chapter 3 (grounding, ground loops)",
)
