"""Eddy currents in the iron: the flux lags the coil current by a half-order law."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Rig

ALL_IRON = 1.5
"""Largest root of tau wc: 1.5 times the iron's share of a magnet's static reluctance.

Sheets of thickness d have the reluctance Rs x coth x, x = sqrt(s mu sigma d^2/4) (Stoll, The Analysis of Eddy Currents,
1974, chapter 2): Rs x high up, Rs (1 + x^2/3) low down. Over the whole static reluctance R, of which Rs is a part, that
is the law with tau = (Rs/R)^2 mu sigma d^2/4 and wc = 9/(mu sigma d^2). Beyond, it would be a first-order lag at every
frequency that is measured, which no iron is. Of a share of the flux alone, tau is in proportion to that share's square.
"""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if p["time_constant_s"] <= 0:
        return rig
    # Two half-order lags in series are, to first order, one whose root of tau is the sum of theirs.
    added = p["time_constant_s"] * shares(rig, p)
    root = np.sqrt(rig.magnets.eddy_time_constant_s) + np.sqrt(added)
    free, gap = p["free_share"], p["displacement_share"]
    corner = min(p["corner_rad_s"], (ALL_IRON * (1 - free)) ** 2 / float(added.max()))
    if np.any(rig.magnets.eddy_time_constant_s):  # eddy currents in the iron that the rig has: same corner and share
        corner, free = rig.magnets.eddy_corner_rad_s, rig.magnets.eddy_free_share
        gap = rig.magnets.eddy_displacement_share
    magnets = replace(
        rig.magnets,
        eddy_time_constant_s=root**2,
        eddy_corner_rad_s=corner,
        eddy_free_share=free,
        eddy_displacement_share=gap,
    )
    return replace(rig, magnets=magnets)


EFFECT = Effect(
    id="eddy_currents",
    path="plant",
    parameters=(
        Parameter(
            "time_constant_s",
            "s",
            1e-9,
            1e-2,
            1.5e-6,
            0.0,
            "log",
            "tau = 1/we of the half-order law; laminated iron 3e-6 to 3e-5, solid above",
        ),
        Parameter(
            "corner_rad_s",
            "rad/s",
            1.0,
            3e5,
            10.0,
            10.0,
            "log",
            "below it the lag is of first order: sheets thinner than the skin depth; solid iron has none; more than "
            "2.25/tau acts as that: all of the reluctance is iron",
            strength=False,
            optional=True,
        ),
        rarely_needed(
            "free_share",
            "1",
            0.0,
            0.998,
            0.0,
            description="share of the flux whose path has no eddy currents, as beside solid parts in laminated iron",
            wakes=(0.5, 0.95),
        ),
        rarely_needed(
            "displacement_share",
            "1",
            0.0,
            1.0,
            0.0,
            description="share of the lag that the flux of a moving rotor has, too: 1 where the force ki i + ks x lags "
            "as a whole",
            wakes=(0.9,),
        ),
        *parameters("magnets", dormant=True),
        of_diagonal("magnets"),
    ),
    apply=_apply,
    law="flux/current = l + (1 - l)/(1 + (sqrt(tau (s + wc)) - sqrt(tau wc))/(1 - l)); solid iron wc = 0; l where a "
    "share of it has no eddy currents; of the force g ks x lags as ki i does",
    signature="y/i: phase lag and gain loss both grow with the root of frequency, at any amplitude",
    aliases=("sensor_lag", "magnetic_hysteresis", "loop_delay", "amplifier_bandwidth"),
    separated_by="a wide band: ln|H|/arg H is 1 here, wT/2 for a first-order lag, 0 for a delay; "
    "a sweep of amplitude at low frequency for hysteresis",
    source="Zhu, Knospe and Maslen, Analytic model for a nonlaminated cylindrical magnetic actuator including eddy "
    "currents, IEEE Trans. Magnetics 41, 2005, pp. 1248-1258; Feeley, IEEE Trans. Magnetics 32, 1996, pp. 453-458",
)
