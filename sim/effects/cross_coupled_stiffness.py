"""Cross-coupled stiffness of a seal or an impeller at the bearings, the same at both or more at one of them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.imbalance import of_end
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    end = p["end_imbalance"]
    added = p["stiffness_n_per_m"] * np.array([1 + end, 1 - end])
    return replace(rig, seal_cross_stiffness_n_per_m=rig.seal_cross_stiffness_n_per_m + added)


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
        ),
        of_end("the seal"),
    ),
    apply=_apply,
    law="f_x = -k (1 +- e) y, f_y = +k (1 +- e) x, + at A",
    signature="antisymmetric off-diagonal x-y of y/i at low frequency; takes damping from one whirl",
    aliases=("gyroscopic_coupling", "magnetic_cross_coupling"),
    separated_by="low frequency: gyroscopic coupling grows with frequency and speed; a rotation of the magnets stays "
    "in proportion to the diagonal at all frequencies",
    source="Childs, Turbomachinery Rotordynamics, Wiley 1993, chapter 4 (annular seals)",
    needs_axes=4,
)
