"""Iron that saturates: less force per ampere at large current."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if p["saturation_inverse_per_a"] < 1e-12:
        return rig
    # Cubic terms i^3/(3 is^2) of saturations in series add.
    inverse = np.hypot(1 / rig.magnets.saturation_current_a, p["saturation_inverse_per_a"])
    return replace(rig, magnets=replace(rig.magnets, saturation_current_a=1 / inverse))


EFFECT = Effect(
    id="magnetic_saturation",
    path="plant",
    parameters=(
        Parameter("saturation_inverse_per_a", "1/A", 0.02, 2.0, 1 / 1.6, 0.0, "log", "1/i_s of i_s tanh(i/i_s)"),
    ),
    apply=_apply,
    law="the force sees i_s tanh(i/i_s)",
    signature="gain of y/i falls with amplitude, third harmonic in y, i clean",
    aliases=("amplifier_voltage_limit", "touchdown_contact", "magnetic_hysteresis"),
    separated_by="harmonics in i (voltage limit); phase of y/i, which saturation leaves alone (hysteresis); "
    "threshold in displacement rather than current (contact)",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 4 (saturation, load capacity)",
    nonlinear=True,
)
