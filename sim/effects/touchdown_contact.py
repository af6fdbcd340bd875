"""Rotor that touches something: a stop, a seal lip, a loose auxiliary bearing."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from sim.datasheet import AXES
from sim.effect import Effect, Parameter, has_axis, has_two_planes, rarely_needed
from sim.errors import EffectError
from sim.rig import Contact, Rig
from sim.sizes import AIR_GAP, STIFFNESS


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if p["stiffness_n_per_m"] == 0:
        return rig
    if rig.contact is not None:
        raise EffectError(f"rig {rig.name} already has a contact; change that one instead of adding another")
    clearance = np.array([p[f"clearance_{axis}_m"] for axis in rig.axes])
    centre = clearance * [p[f"centre_{axis}"] for axis in rig.axes]
    return replace(rig, contact=Contact(clearance, p["stiffness_n_per_m"], p["side"], centre, p["ring"]))


EFFECT = Effect(
    id="touchdown_contact",
    path="plant",
    parameters=(
        Parameter(
            "stiffness_n_per_m", "N/m", 1e4, 1e8, 1e6, 0.0, "log", "of the stop, at each bearing", goes_with=STIFFNESS
        ),
        Parameter("side", "1", -1.0, 1.0, 0.0, 0.0, description="1: only above, -1: only below", strength=False),
        *(
            Parameter(
                f"clearance_{axis}_m",
                "m",
                1e-6,
                2.5e-4,
                12e-6,
                12e-6,
                "log",
                f"free way in {axis}; not used on a rig without that axis",
                needs=partial(has_axis, axis),
                goes_with=AIR_GAP,
                strength=False,
            )
            for axis in AXES
        ),
        rarely_needed(
            "ring",
            "1",
            0.0,
            1.0,
            0.0,
            description="1 where the stops of both planes at a bearing are one ring; not used on one plane",
            needs=has_two_planes,
        ),
        *(
            rarely_needed(
                f"centre_{axis}",
                "1",
                -0.8,
                0.8,
                0.0,
                description=f"where the middle of the free way in {axis} is, over half of its width",
                needs=partial(has_axis, axis),
            )
            for axis in AXES
        ),
    ),
    apply=_apply,
    law="f = -k (|x| - c) sign x where |x| > c, to either side or to one; of a ring f = -k (1 - c/r) (x, y) where "
    "r = |(x, y)| > c; x, y from its middle",
    signature="nothing below a threshold in displacement, above it gain falls, jumps, rich odd harmonics in y",
    aliases=("magnetic_saturation",),
    separated_by="a lower amplitude; the threshold is in displacement at low frequency, saturation's is in current",
    source="Black, Interaction of a whirling rotor with a vibrating stator across a clearance annulus, "
    "J. Mech. Eng. Sci. 10, 1968, pp. 1-12",
    nonlinear=True,
)
