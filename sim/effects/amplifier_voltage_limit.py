"""The supply voltage limits how fast the coil current can change."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Rig
from sim.sizes import BIAS


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if p["slew_inverse_s_per_a"] < 1e-12:
        return rig
    with np.errstate(divide="ignore"):  # an axis without a limit
        slew = np.minimum(rig.amplifiers.slew_limit_a_per_s, 1 / (p["slew_inverse_s_per_a"] * shares(rig, p)))
    limited = replace(
        rig.amplifiers,
        slew_limit_a_per_s=slew,
        slew_seen=p["slope_seen"],
        slope_noise_share=p["slope_noise_share"],
    )
    return replace(rig, amplifiers=limited)


EFFECT = Effect(
    id="amplifier_voltage_limit",
    path="amplifier",
    parameters=(
        Parameter(
            "slew_inverse_s_per_a",
            "s/A",
            1e-5,
            2e-3,
            2.5e-4,
            0.0,
            "log",
            "inverse of the largest |di/dt| = U/L",
            goes_with=BIAS**-1,
        ),
        Parameter(
            "slope_seen",
            "1",
            0.0,
            1.0,
            0.0,
            0.0,
            description="share of the current loop's damping that acts on the slope the coil has; "
            "nothing on a first-order amplifier",
            strength=False,
        ),
        rarely_needed(
            "slope_noise_share",
            "1",
            0.0,
            0.4,
            0.0,
            description="root mean square of the slopes that noise asks of a coil, over the limit",
            wakes=(0.05,),
        ),
        *parameters("amplifiers", dormant=True),
        of_diagonal("amplifiers"),
    ),
    apply=_apply,
    law="|di/dt| <= U_dc/L; below it the amplifier is linear",
    signature="i/u falls above a threshold in amplitude times frequency; odd harmonics in i",
    aliases=("amplifier_bandwidth", "magnetic_saturation"),
    separated_by="a second amplitude at one frequency (bandwidth stays); harmonics in i (clean with saturation)",
    source="Maslen, Hermann, Scott and Humphris, Practical limits to the performance of magnetic bearings, "
    "J. Tribology 111, 1989, pp. 331-336",
    nonlinear=True,
)
