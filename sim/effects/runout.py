"""Sensor surface that is not round or not even: a signal that turns with the rotor."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.rig import Disturbance, Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if p["amplitude_m"] == 0:
        return rig
    n = rig.n_axes
    # The y sensors see the same mark a quarter of a turn later.
    phase = np.array([-math.pi / 2 * (axis // 2) for axis in range(n)])
    added = Disturbance("y", np.full(n, p["amplitude_m"]), phase, order=1.0)
    return replace(rig, disturbances=(*rig.disturbances, added))


EFFECT = Effect(
    id="runout",
    path="additive",
    parameters=(Parameter("amplitude_m", "m", 1e-8, 1e-3, 2e-6, 0.0, "log", "once a turn, on every sensor"),),
    apply=_apply,
    law="+ a cos(W t), y a quarter turn behind x",
    signature="a line at the speed, not in proportion to the excitation, which follows the speed",
    aliases=("mains_interference",),
    separated_by="a record without excitation at two speeds; unbalance grows with W^2 and shows in i/u as a real force",
    source="API Standard 670, 5th ed., 2014 (mechanical and electrical runout)",
    needs_speed=True,
)
