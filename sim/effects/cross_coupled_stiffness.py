"""Cross-coupled stiffness of a seal or an impeller, at the bearings, between them or outside, nearer to one or alike.

Most seals damp as well, in a ratio to their cross stiffness that is much alike: damping is stated by it, so that a
damper alone is not taken for a seal. Their direct stiffness is small, and cannot be told from the magnets'.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_end
from sim.rig import Rig
from sim.sizes import MASS, STIFFNESS

BOWS = ("mode1_bow_per_sqrt_kg", "mode2_bow_per_sqrt_kg")


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    end, between, damps = p["end_imbalance"], p["between"], p["inverse_whirl_ratio"]
    of_ends, lever = np.array([1 + end, 1 - end]), end * (1 + p["overhang"])
    of_lever = np.array([1 + lever, 1 - lever])
    # one away from both bearings has the same total stiffness; it meets the weighted mean of both displacements, or,
    # outside them, the straight line through both
    shape = (1 - between) * np.diag(of_ends) + between * np.outer(of_lever, of_lever) / 2
    return replace(
        rig,
        seal_cross_stiffness_n_per_m=rig.seal_cross_stiffness_n_per_m + p["stiffness_n_per_m"] * shape,
        seal_cross_stiffness_by_speed_ns_per_m=rig.seal_cross_stiffness_by_speed_ns_per_m
        + p["by_speed_ns_per_m"] * shape,
        seal_damping_ns_per_m=rig.seal_damping_ns_per_m + damps * abs(p["by_speed_ns_per_m"]) * shape,
        seal_damping_times_speed_n_per_m=rig.seal_damping_times_speed_n_per_m
        + damps * abs(p["stiffness_n_per_m"]) * shape,
        seal_bow_per_sqrt_kg=_bows(rig, p),
    )


def _bows(rig: Rig, p: Mapping[str, float]) -> tuple[float, ...]:
    """Those of the rig and of the effect together; none where it has none."""
    own = tuple(p[name] for name in BOWS)
    return (
        tuple(map(sum, zip_longest(rig.seal_bow_per_sqrt_kg, own, fillvalue=0.0)))
        if any(own)
        else rig.seal_bow_per_sqrt_kg
    )


def _bow(mode: int, wakes: tuple[float, ...]) -> Parameter:
    return rarely_needed(
        BOWS[mode - 1],
        "1/sqrt(kg)",
        -0.6,
        0.6,
        0.0,
        description=f"how much farther mode {mode} moves the shaft at the seal than at the bearings",
        wakes=wakes,
        goes_with=MASS**-0.5,
    )


EFFECT = Effect(
    id="cross_coupled_stiffness",
    path="plant",
    parameters=(
        Parameter(
            "stiffness_n_per_m",
            "N/m",
            -1e7,
            1e7,
            1e5,
            0.0,
            description="at each bearing, mean of both, sign of the whirl",
            goes_with=STIFFNESS,
        ),
        rarely_needed(
            "by_speed_ns_per_m",
            "N s/m",
            -1e5,
            1e5,
            0.0,
            description="what each rad/s adds to it, as the rotor carries the fluid round; told by two speeds alone",
            goes_with=STIFFNESS,
        ),
        rarely_needed(
            "inverse_whirl_ratio",
            "1",
            0.0,
            4.0,
            0.0,
            description="of direct damping c in the same places: c |W| / (|k| + |k' W|); about 2 where fluid goes "
            "round at half the speed of the rotor, which at rest shows none",
            wakes=(1.0,),
        ),
        of_end("the seal"),
        Parameter(
            "between",
            "1",
            0.0,
            1.0,
            0.0,
            0.0,
            description="share of it that is in one place away from both, nearer to one as the imbalance tells",
            strength=False,
            optional=True,
        ),
        rarely_needed(
            "overhang",
            "1",
            0.0,
            2.0,
            0.0,
            description="how far what is not at the bearings is beyond the one to which the imbalance tells, over half "
            "their distance and times the imbalance: an impeller outside them",
            wakes=(0.5,),
        ),
        _bow(1, (0.1, -0.1)),  # one of the other sign is another local minimum
        _bow(2, (0.02,)),
    ),
    apply=_apply,
    law="f_x = -(1 +- e) ((k + k' W) y + c x'), f_y = (1 +- e) ((k + k' W) x - c y'), + at A; away from both bearings "
    "twice of it at the mean of both displacements, weighted by 1 +- e (1 + v), and what flexible modes move the shaft "
    "farther there, d q",
    signature="antisymmetric off-diagonal x-y of y/i at low frequency; takes damping from one whirl",
    aliases=("gyroscopic_coupling", "magnetic_cross_coupling"),
    separated_by="low frequency: gyroscopic coupling grows with frequency and speed; a rotation of the magnets stays "
    "in proportion to the diagonal at all frequencies",
    source="Childs, Turbomachinery Rotordynamics, Wiley 1993, chapter 4 (annular seals)",
    needs_axes=4,
)
