"""Magnets that pull across: the force of the x pair has a part in y, and the reverse."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_end
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    m, of_ends = rig.magnets, np.array([1 + p["end_imbalance"], 1 - p["end_imbalance"]])
    return replace(
        rig,
        magnets=replace(
            m,
            cross_coupling_rad=m.cross_coupling_rad + p["rotation_rad"] * of_ends,
            cross_coupling_symmetric=m.cross_coupling_symmetric + p["symmetric_share"] * of_ends,
            turned_whole=max(m.turned_whole, p["turned_whole"]),
        ),
    )


EFFECT = Effect(
    id="magnetic_cross_coupling",
    path="plant",
    parameters=(
        Parameter("rotation_rad", "rad", -0.2, 0.2, 0.04, 0.0, description="magnets turned against the sensors"),
        Parameter("symmetric_share", "1", -0.2, 0.2, 0.01, 0.0, description="share of the flux that closes across"),
        rarely_needed(
            "turned_whole",
            "1",
            0.0,
            1.0,
            0.0,
            description="1 where the magnets' axes are turned, so that displacements pull along them, too",
            wakes=(0.9,),
        ),
        of_end("the magnets", dormant=True),
    ),
    apply=_apply,
    law="f_x = cos(phi) f0_x + (c + sin(phi)) f0_y, f_y = (c - sin(phi)) f0_x + cos(phi) f0_y, "
    "f0 of the uncoupled magnets; where w of them is turned whole, f + w (R ks R^T - R ks) x, R the matrix above",
    signature="off-diagonal x-y of y/i at standstill, at all frequencies in proportion to the diagonal",
    aliases=("cross_coupled_stiffness", "gyroscopic_coupling", "channel_crosstalk"),
    separated_by="a seal is antisymmetric and quasi-static only; gyroscopic coupling vanishes at standstill; logged i "
    "has the crosstalk",
    source="Meeker, Maslen and Noh, Augmented circuit model for magnetic bearings including eddy currents, fringing "
    "and leakage, IEEE Trans. Magnetics 32, 1996, pp. 3219-3227",
    needs_axes=4,
)
