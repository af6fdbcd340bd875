"""Hysteresis of the iron: a loss angle that grows with amplitude and does not depend on frequency."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.actuator import PLAY_EDGES
from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Rig
from sim.sizes import BIAS

DENSITIES = tuple(f"density_{k + 1}" for k in range(len(PLAY_EDGES) - 1))
"""Names of the parameters that are `Magnets.hysteresis_density`."""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    m, angle = rig.magnets, p["loss_angle_rad"] * rig.magnets.hysteresis_reference_a / 0.5
    magnets = replace(m, hysteresis_rad=m.hysteresis_rad + angle * shares(rig, p))
    if not np.any(m.hysteresis_rad):  # else more of the plays that the rig has
        magnets = replace(
            magnets,
            hysteresis_narrowest_a=p["narrowest_a"],
            hysteresis_widest_inverse_per_a=p["widest_inverse_per_a"],
            hysteresis_density=tuple(p[name] for name in DENSITIES),
            hysteresis_displacement_share=p["displacement_share"],
        )
    return replace(rig, magnets=magnets)


EFFECT = Effect(
    id="magnetic_hysteresis",
    path="plant",
    parameters=(
        Parameter(
            "loss_angle_rad",
            "rad",
            1e-4,
            0.3,
            0.02,
            0.0,
            "log",
            "lag of the force at 0.5 A of coil current, of a Rayleigh loop as dense as these plays are",
            goes_with=BIAS**-1,
        ),
        Parameter(
            "narrowest_a",
            "A",
            0.0,
            1.5,
            0.0,
            0.0,
            description="half width of the narrowest play; 0 for a Rayleigh loop, which is plays of every width",
            goes_with=BIAS,
            strength=False,
            optional=True,
        ),
        Parameter(
            "widest_inverse_per_a",
            "1/A",
            0.0,
            50.0,
            0.0,
            0.0,
            description="1 / half width of the widest play, 0 for no end; of one play that of the narrowest",
            goes_with=BIAS**-1,
            strength=False,
            optional=True,
        ),
        rarely_needed(
            "displacement_share",
            "1",
            0.0,
            1.0,
            0.0,
            description="share in which the plays follow the flux of a moving rotor, too: 1 where they lag behind "
            "ki i + ks x",
            wakes=(0.9,),
        ),
        *(
            rarely_needed(
                name,
                "1",
                0.0,
                1000.0,
                0.0,
                description=f"more plays, of half widths from {100 * low:.2g} to {200 * low:.2g} % of the bias "
                "current: how dense over those of the Rayleigh loop",
            )
            for name, low in zip(DENSITIES, PLAY_EDGES, strict=False)
        ),
        *parameters("magnets", dormant=True),
        of_diagonal("magnets"),
    ),
    apply=_apply,
    law="b = i + 2 alpha r2/(r2 - r1) integral play_r(i) dr, r = r1..r2; all r: (1 + alpha A) i +- alpha/2 (A^2 - i^2)"
    "; denser by d_k from one width to its double; the plays follow i + g ks/ki x",
    signature="lag and gain of y/i grow with the current's amplitude A, the same at any frequency; odd harmonics in y",
    aliases=("eddy_currents", "magnetic_saturation"),
    separated_by="a sweep of amplitude at low frequency: eddy currents do not depend on it, saturation has no lag",
    source="Lord Rayleigh, On the behaviour of iron and steel under the operation of feeble magnetic forces, "
    "Phil. Mag. 23, 1887, pp. 225-245; Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989",
    nonlinear=True,
)
