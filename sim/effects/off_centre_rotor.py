"""Rotor held off the magnetic centre, axis by axis."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from sim.effect import Effect, Parameter, has_axis
from sim.errors import EffectError
from sim.rig import Rig
from sim.sizes import AIR_GAP

_TYPICAL = {"xA": 45e-6, "xB": -30e-6, "yA": 25e-6, "yB": -40e-6}


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    offset = np.array([p[f"offset_{axis}_m"] for axis in rig.axes])
    offset = rig.magnets.offset_m + offset
    if (beyond := np.abs(offset) >= rig.magnets.gap_m).any():
        k = int(np.argmax(beyond))
        raise EffectError(
            f"off_centre_rotor: {rig.axes[k]} of rig {rig.name} would be {offset[k]:.3g} m off, in an air gap of "
            f"{rig.magnets.gap_m[k]:.3g} m"
        )
    return replace(rig, magnets=replace(rig.magnets, offset_m=offset))


EFFECT = Effect(
    id="off_centre_rotor",
    path="plant",
    parameters=tuple(
        Parameter(
            f"offset_{axis}_m",
            "m",
            -1.2e-4,
            1.2e-4,
            typical,
            0.0,
            description=f"magnetic against sensor centre in {axis}; not used on a rig without that axis",
            needs=partial(has_axis, axis),
            goes_with=AIR_GAP,
        )
        for axis, typical in _TYPICAL.items()
    ),
    apply=_apply,
    law="exact force law at x + x0: ki (1 + xi^2)/(1 - xi^2)^2, ks (1 + 3 xi^2)/(1 - xi^2)^3, xi = x0/s0",
    signature="ki and ks of one channel rise, ks about twice as much; even harmonics in y",
    aliases=("sensor_gain", "thermal_drift"),
    separated_by="second harmonic of y; a sweep of the set-point (a wrong bias too has dln ks/dln ki of 2)",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 4 (exact force law)",
    nonlinear=True,
)
