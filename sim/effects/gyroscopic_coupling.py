"""Gyroscopic moment of the turning rotor, of which a disc may sit where flexible modes tilt it."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import chain, repeat

from sim.effect import Effect, Parameter, has_modes, rarely_needed
from sim.rig import Disc, FlexibleMode, Rig
from sim.sizes import INERTIA, SLOPE

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Modes that the moments of a whole shaft couple with each other."""
SLOPED = 3
"""First modes that tilt a disc."""


def _slope_name(mode: int) -> str:
    return f"mode{mode}_slope_per_m_sqrt_kg"


def _between_name(pair: tuple[int, int]) -> str:
    return f"mode{pair[0] + 1}_to_mode{pair[1] + 1}_coupling"


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    n_modes = min(map(len, rig.rotor.modes))
    more = p["coupling_imbalance"] if n_modes > 1 else 0.0
    shares = chain((1 + more, 1 - more), repeat(1.0))
    beyond = (p["mode3_coupling"] if k == SLOPED - 1 else 0.0 for k in range(n_modes))
    own = [p["mode_coupling"] * share + extra for share, extra in zip(shares, beyond, strict=False)]

    def coupled(modes: tuple[FlexibleMode, ...]) -> tuple[FlexibleMode, ...]:
        return tuple(replace(m, gyroscopic=m.gyroscopic + g) for m, g in zip(modes, own, strict=False))

    rotor, slopes = rig.rotor, tuple(p[_slope_name(k)] for k in range(1, SLOPED + 1))
    between = tuple((*pair, g) for pair in PAIRS if (g := p[_between_name(pair)]) and max(pair) < n_modes)
    rotor = replace(
        rotor, modes=tuple(map(coupled, rotor.modes)), gyroscopic_between=(*rotor.gyroscopic_between, *between)
    )
    if any(slopes):
        return replace(rig, rotor=replace(rotor, discs=(*rotor.discs, Disc(p["polar_inertia_kgm2"], slopes))))
    return replace(rig, rotor=replace(rotor, polar_inertia_kgm2=rotor.polar_inertia_kgm2 + p["polar_inertia_kgm2"]))


def _slope(mode: int) -> Parameter:
    return rarely_needed(
        _slope_name(mode),
        "1/(m sqrt(kg))",
        -3.0,
        3.0,
        0.0,
        description=f"tilt of that inertia per displacement of mode {mode}; 0: it tilts with the rigid body alone",
        wakes=(0.3, -0.3) if mode < SLOPED else (0.1,),  # a slope of the other sign is another local minimum
        needs=partial(has_modes, number=mode),
        goes_with=SLOPE,
    )


def _between(pair: tuple[int, int]) -> Parameter:
    first, second = (k + 1 for k in pair)
    return rarely_needed(
        _between_name(pair),
        "1",
        -0.5,
        0.5,
        0.0,
        description=f"the same between mode {first} of one plane and mode {second} of the other, beyond a disc's",
        wakes=(0.002,),
        needs=partial(has_modes, number=second),
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
        _slope(3),
        rarely_needed(
            "mode3_coupling",
            "1",
            -0.5,
            0.5,
            0.0,
            description="g of the third mode beyond that mean",
            wakes=(0.002,),
            needs=partial(has_modes, number=3),
        ),
        *map(_between, PAIRS),
    ),
    apply=_apply,
    law="I th_x'' + Ip W th_y' = .., I th_y'' - Ip W th_x' = .., th the tilt where Ip is; the same with g per mode, "
    "and of a whole shaft also between modes",
    signature="peaks split in proportion to speed, antisymmetric off-diagonal x-y of y/i, nil at standstill",
    aliases=("cross_coupled_stiffness", "magnetic_cross_coupling"),
    separated_by="a second speed; a seal acts on damping and at low frequency, magnets also at standstill",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapters 3 and 4 (gyroscopic effect)",
    needs_axes=4,
    needs_speed=True,
)
