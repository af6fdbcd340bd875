"""Gyroscopic moment of the turning rotor, of which a disc may sit where flexible modes tilt it."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain, repeat

from sim.effect import Effect, Parameter, rarely_needed
from sim.rig import Disc, FlexibleMode, Rig
from sim.sizes import INERTIA, SLOPE


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    more = p["coupling_imbalance"] if min(map(len, rig.rotor.modes)) > 1 else 0.0

    def coupled(modes: tuple[FlexibleMode, ...]) -> tuple[FlexibleMode, ...]:
        own = (p["mode_coupling"] * share for share in chain((1 + more, 1 - more), repeat(1.0)))
        return tuple(replace(m, gyroscopic=m.gyroscopic + g) for m, g in zip(modes, own, strict=False))

    rotor, slopes = rig.rotor, (p["mode1_slope_per_m_sqrt_kg"], p["mode2_slope_per_m_sqrt_kg"])
    rotor = replace(rotor, modes=tuple(map(coupled, rotor.modes)))
    if any(slopes):
        return replace(rig, rotor=replace(rotor, discs=(*rotor.discs, Disc(p["polar_inertia_kgm2"], slopes))))
    return replace(rig, rotor=replace(rotor, polar_inertia_kgm2=rotor.polar_inertia_kgm2 + p["polar_inertia_kgm2"]))


def _slope(mode: int) -> Parameter:
    return rarely_needed(
        f"mode{mode}_slope_per_m_sqrt_kg",
        "1/(m sqrt(kg))",
        -3.0,
        3.0,
        0.0,
        description=f"tilt of that inertia per displacement of mode {mode}; 0: it tilts with the rigid body alone",
        wakes=(0.3, -0.3),  # a slope of the other sign is another local minimum
        goes_with=SLOPE,
    )


EFFECT = Effect(
    id="gyroscopic_coupling",
    path="plant",
    parameters=(
        Parameter(
            "polar_inertia_kgm2",
            "kg m2",
            -20.0,
            20.0,
            1.9,
            0.0,
            description="beside what a twin with this effect states; negative where the rotor turns from y to x",
            goes_with=INERTIA,
        ),
        rarely_needed(
            "mode_coupling",
            "1",
            -0.5,
            0.5,
            0.0,
            description="g of q'' + g W q' between the two planes' copies of each flexible mode, mean of the first two",
            wakes=(0.01,),
        ),
        rarely_needed(
            "coupling_imbalance",
            "1",
            -1.0,
            1.0,
            0.0,
            description="1: g only of the first mode, -1: only of the second; nothing on a rotor with one",
            wakes=(0.3,),
        ),
        _slope(1),
        _slope(2),
    ),
    apply=_apply,
    law="I th_x'' + Ip W th_y' = .., I th_y'' - Ip W th_x' = .., th the tilt where Ip is; the same with g per mode",
    signature="peaks split in proportion to speed, antisymmetric off-diagonal x-y of y/i, nil at standstill",
    aliases=("cross_coupled_stiffness", "magnetic_cross_coupling"),
    separated_by="a second speed; a seal acts on damping and at low frequency, magnets also at standstill",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapters 3 and 4 (gyroscopic effect)",
    needs_axes=4,
    needs_speed=True,
)
