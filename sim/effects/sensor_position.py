"""Sensors nearer to or farther from the centre of gravity than drawn."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter, rarely_needed
from sim.rig import FlexibleMode, Rig
from sim.sizes import SLOPE, SPAN

SLOPED = 2
"""First modes whose shapes change along the shaft by a slope of their own."""
ENDS = ("A", "B")


def _slope_name(mode: int, end: str) -> str:
    return f"mode{mode}_slope_{end}_per_m_sqrt_kg"


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    shifts = [p[f"shift_{end}_m"] for end in ENDS]

    def moved(modes: tuple[FlexibleMode, ...]) -> tuple[FlexibleMode, ...]:
        changed = []
        for k, m in enumerate(modes[:SLOPED], start=1):
            more = [p[_slope_name(k, end)] * shift for end, shift in zip(ENDS, shifts, strict=True)]
            a, b = m.shape_at_sensors
            changed.append(replace(m, shape_at_sensors=(a + more[0], b + more[1])))
        return (*changed, *modes[SLOPED:])

    a, b = rig.rotor.sensor_from_cog_m
    rotor = replace(rig.rotor, sensor_from_cog_m=(a + shifts[0], b + shifts[1]))
    return replace(rig, rotor=replace(rotor, modes=tuple(map(moved, rotor.modes))))


def _slope(mode: int, end: str) -> Parameter:
    return rarely_needed(
        _slope_name(mode, end),
        "1/(m sqrt(kg))",
        -3.0,
        3.0,
        0.0,
        description=f"by which the shape of mode {mode} at sensor {end} changes with its distance",
        wakes=(0.1,),
        goes_with=SLOPE,
    )


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
        *(_slope(mode, end) for mode in range(1, SLOPED + 1) for end in ENDS),
    ),
    apply=_apply,
    law="rows [1, dsA + a] and [1, -(dsB + b)] of the rigid sensor map; a mode's shapes there change by a slope times "
    "a, b, or stay where no slope is stated",
    signature="zeros of y/i move, poles do not; off-diagonals change most",
    aliases=("rotor_inertia", "sensor_gain"),
    separated_by="two flexible modes, or the rigid poles, which inertia moves and the sensor's place does not",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 7 (sensor and bearing coordinates)",
)
