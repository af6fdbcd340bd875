"""Cross-coupled stiffness of a seal or an impeller at both bearings."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    stiffness = rig.seal_cross_stiffness_n_per_m + p["stiffness_n_per_m"]
    return replace(rig, seal_cross_stiffness_n_per_m=stiffness)


EFFECT = Effect(
    id="cross_coupled_stiffness",
    path="plant",
    parameters=(
        Parameter("stiffness_n_per_m", "N/m", -1e7, 1e7, 1e5, 0.0, description="at each bearing, sign of the whirl"),
    ),
    apply=_apply,
    law="f_x = -k y, f_y = +k x",
    signature="antisymmetric off-diagonal x-y of y/i at low frequency; takes damping from one whirl",
    aliases=("gyroscopic_coupling", "magnetic_cross_coupling"),
    separated_by="low frequency: gyroscopic coupling grows with frequency and speed; a rotation of the magnets stays "
    "in proportion to the diagonal at all frequencies",
    source="Childs, Turbomachinery Rotordynamics, Wiley 1993, chapter 4 (annular seals)",
    needs_axes=4,
)
