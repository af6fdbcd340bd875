"""Sensors nearer to or farther from the centre of gravity than drawn."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.rig import Rig
from sim.sizes import SPAN


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    a, b = rig.rotor.sensor_from_cog_m
    rotor = replace(rig.rotor, sensor_from_cog_m=(a + p["shift_A_m"], b + p["shift_B_m"]))
    return replace(rig, rotor=rotor)


EFFECT = Effect(
    id="sensor_position",
    path="plant",
    parameters=(
        Parameter(
            "shift_A_m", "m", -0.04, 0.04, 0.012, 0.0, description="away from the centre of gravity", goes_with=SPAN
        ),
        Parameter(
            "shift_B_m", "m", -0.04, 0.04, 0.012, 0.0, description="away from the centre of gravity", goes_with=SPAN
        ),
    ),
    apply=_apply,
    law="rows [1, dsA + a] and [1, -(dsB + b)] of the rigid sensor map; the modes' shapes at the sensors are kept",
    signature="zeros of y/i move, poles do not; off-diagonals change most",
    aliases=("rotor_inertia", "sensor_gain"),
    separated_by="two flexible modes, or the rigid poles, which inertia moves and the sensor's place does not",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 7 (sensor and bearing coordinates)",
)
