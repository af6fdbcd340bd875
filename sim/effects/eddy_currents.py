"""Eddy currents in the iron: the flux lags the coil current by a half-order law."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    # Two half-order lags in series are, to first order, one whose root of tau is the sum of theirs.
    root = np.sqrt(rig.magnets.eddy_time_constant_s) + math.sqrt(p["time_constant_s"])
    return replace(rig, magnets=replace(rig.magnets, eddy_time_constant_s=root**2))


EFFECT = Effect(
    id="eddy_currents",
    path="plant",
    parameters=(
        Parameter(
            "time_constant_s",
            "s",
            1e-8,
            1e-4,
            1.5e-6,
            0.0,
            "log",
            "tau = 1/we; laminated iron 3e-6 to 3e-5, solid above",
        ),
    ),
    apply=_apply,
    law="flux/current = 1/(1 + sqrt(s tau))",
    signature="y/i: phase lag and gain loss both grow with the root of frequency, at any amplitude",
    aliases=("sensor_lag", "magnetic_hysteresis", "loop_delay", "amplifier_bandwidth"),
    separated_by="a wide band: dln|H|/darg H is 1 here, wT/2 for a first-order lag, 0 for a delay; "
    "a sweep of amplitude at low frequency for hysteresis",
    source="Zhu, Knospe and Maslen, Analytic model for a nonlaminated cylindrical magnetic actuator including eddy "
    "currents, IEEE Trans. Magnetics 41, 2005, pp. 1248-1258; Feeley, IEEE Trans. Magnetics 32, 1996, pp. 453-458",
)
