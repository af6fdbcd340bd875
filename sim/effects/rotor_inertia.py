"""Rotor heavier or longer than the datasheet says, or with its centre of gravity elsewhere."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter, rarely_needed
from sim.rig import Rig
from sim.sizes import SPAN


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    shift = p["centre_shift_m"]
    rotor = replace(
        rig.rotor,
        bearing_from_cog_m=_nearer_to_a(rig.rotor.bearing_from_cog_m, shift),
        sensor_from_cog_m=_nearer_to_a(rig.rotor.sensor_from_cog_m, shift),
        mass_kg=rig.rotor.mass_kg * (1 + p["mass_change"]),
        transverse_inertia_kgm2=rig.rotor.transverse_inertia_kgm2 * (1 + p["inertia_change"]),
    )
    return replace(rig, rotor=rotor)


def _nearer_to_a(from_cog_m: tuple[float, float], shift_m: float) -> tuple[float, float]:
    a, b = from_cog_m
    return a - shift_m, b + shift_m


EFFECT = Effect(
    id="rotor_inertia",
    path="plant",
    parameters=(
        Parameter("mass_change", "1", -0.3, 0.5, 0.05, 0.0, description="relative"),
        Parameter("inertia_change", "1", -0.3, 0.5, 0.08, 0.0, description="relative, transverse inertia"),
        rarely_needed(
            "centre_shift_m",
            "m",
            -0.05,
            0.05,
            0.0,
            description="of the centre of gravity towards A, as by a hub or an impeller that the datasheet lacks",
            wakes=(0.005, -0.005),
            goes_with=SPAN,
        ),
    ),
    apply=_apply,
    law="M^-1 = 1/m [[1, 1], [1, 1]] + 1/I [[dA^2, -dA dB], [-dA dB, dB^2]] with m (1 + dm), I (1 + dI); bearings and "
    "sensors are nearer to the centre of gravity at A, and farther at B, by its shift",
    signature="y/i above the rigid poles scales, with a pattern over A and B that neither gain of a channel gives",
    aliases=("sensor_position", "sensor_gain"),
    separated_by="zeros and the residues of two flexible modes (sensor position); an added known mass",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapter 3 (four degrees of freedom)",
)
