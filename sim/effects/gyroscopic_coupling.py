"""Gyroscopic moment of the turning rotor."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.rig import FlexibleMode, Rig
from sim.sizes import INERTIA


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    def coupled(m: FlexibleMode) -> FlexibleMode:
        return replace(m, gyroscopic=m.gyroscopic + p["mode_coupling"])

    rotor = replace(
        rig.rotor,
        polar_inertia_kgm2=rig.rotor.polar_inertia_kgm2 + p["polar_inertia_kgm2"],
        modes=tuple(tuple(coupled(m) for m in plane) for plane in rig.rotor.modes),
    )
    return replace(rig, rotor=rotor)


EFFECT = Effect(
    id="gyroscopic_coupling",
    path="plant",
    parameters=(
        Parameter(
            "polar_inertia_kgm2",
            "kg m2",
            -2.0,
            20.0,
            1.9,
            0.0,
            description="beyond that of the datasheet",
            goes_with=INERTIA,
        ),
        Parameter(
            "mode_coupling",
            "1",
            -0.5,
            0.5,
            0.02,
            0.0,
            description="g of q'' + g W q' between the two planes' copies of each flexible mode",
        ),
    ),
    apply=_apply,
    law="I th_x'' + Ip W th_y' = .., I th_y'' - Ip W th_x' = ..; the same with g per flexible mode",
    signature="peaks split in proportion to speed, antisymmetric off-diagonal x-y of y/i, nil at standstill",
    aliases=("cross_coupled_stiffness", "magnetic_cross_coupling"),
    separated_by="a second speed; a seal acts on damping and at low frequency, magnets also at standstill",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapter 3 (gyroscopic effect)",
    needs_axes=4,
    needs_speed=True,
)
