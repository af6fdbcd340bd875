"""Sensor gains off, channel by channel."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from sim.effect import Effect, Parameter, has_axis
from sim.rig import Rig

_TYPICAL = {"xA": 0.05, "xB": -0.03, "yA": -0.04, "yB": 0.02}


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    change = np.array([p[f"gain_change_{axis}"] for axis in rig.axes])
    return replace(rig, sensors=replace(rig.sensors, gain=rig.sensors.gain * (1 + change)))


EFFECT = Effect(
    id="sensor_gain",
    path="plant",
    parameters=tuple(
        Parameter(
            f"gain_change_{axis}",
            "1",
            -0.3,
            0.3,
            typical,
            0.0,
            description=f"relative, sensor {axis}; not used on a rig without that axis",
            needs=partial(has_axis, axis),
        )
        for axis, typical in _TYPICAL.items()
    ),
    apply=_apply,
    law="y = g (1 + dg) x",
    signature="one row of y/i scales, at all frequencies and amplitudes",
    aliases=("rotor_inertia", "off_centre_rotor", "sensor_position"),
    separated_by="a gain common to all sensors is an exact alias of ki at small signal: a bump against the clearance, "
    "a trial unbalance or a known force tells them apart",
    source="Gähler, Mohler and Herzog, Multivariable identification of active magnetic bearing systems, "
    "JSME Int. J. Series C 40, 1997, pp. 584-592",
)
