"""Share of one channel's control signal in another amplifier, of the same plane, of the same bearing or of neither."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter, has_two_planes, rarely_needed
from sim.imbalance import of_plane
from sim.rig import Rig

ACROSS = (("xA", "yB"), ("xB", "yA"), ("yA", "xB"), ("yB", "xA"))
"""Amplifiers and the control signals in them of the other plane at the other bearing."""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    plane = np.array([[0.0, p["share_ab"]], [p["share_ba"], 0.0]])
    more = p["plane_imbalance"]
    if rig.n_planes == 1:
        share = plane
    else:
        share = np.kron(np.diag([1 + more, 1 - more]), plane)
        for (x, y), end in zip(((0, 2), (1, 3)), "AB", strict=True):
            share[x, y], share[y, x] = p[f"share_xy_{end}"], p[f"share_yx_{end}"]
        for into, out_of in ACROSS:
            share[rig.axes.index(into), rig.axes.index(out_of)] = p[f"share_{into}_{out_of}"]
    return replace(rig, amplifiers=replace(rig.amplifiers, crosstalk=rig.amplifiers.crosstalk + share))


EFFECT = Effect(
    id="channel_crosstalk",
    path="amplifier",
    parameters=(
        Parameter(
            "share_ab", "1", -0.2, 0.2, 0.03, 0.0, description="share of u_B in amplifier A, mean of both planes"
        ),
        Parameter(
            "share_ba", "1", -0.2, 0.2, 0.03, 0.0, description="share of u_A in amplifier B, mean of both planes"
        ),
        *(
            rarely_needed(
                f"share_{into}{out_of}_{end}",
                "1",
                -0.2,
                0.2,
                0.0,
                description=f"share of u_{out_of}{end} in amplifier {into}{end}; not used on one plane",
                wakes=(0.01,),
                needs=has_two_planes,
            )
            for end in "AB"
            for into, out_of in ("xy", "yx")
        ),
        *(
            rarely_needed(
                f"share_{into}_{out_of}",
                "1",
                -0.2,
                0.2,
                0.0,
                description=f"share of u_{out_of} in amplifier {into}; not used on one plane",
                wakes=(0.01,),
                needs=has_two_planes,
            )
            for into, out_of in ACROSS
        ),
        of_plane("the crosstalk", dormant=True),
    ),
    apply=_apply,
    law="i_A = A (u_A + c_AB u_B), i_B = A (u_B + c_BA u_A), in each plane; shares c (1 + p) in x and c (1 - p) in y; "
    "at either bearing c_xy u_y in i_x, c_yx u_x in i_y, and the same from one bearing to the other",
    signature="off-diagonal of i/u, within a plane or a bearing as a rule, in phase with the diagonal",
    aliases=("magnetic_cross_coupling",),
    separated_by="logged i; without it the off-diagonals of y/u, which sensor position and mode shapes change too, and "
    "turned magnets as crosstalk between the planes",
    source="Ott, Electromagnetic Compatibility Engineering, Wiley 2009, section 2.1 (crosstalk between channels)",
)
