"""What a rig's effects are as large as: a stop or a housing that 280 kg would hardly feel carries 3 kg away.

Ranges of effects are stated for the reference rig (`sim.reference`), and go with the rig they are asked of.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from sim.rig import Rig


@dataclass(frozen=True)
class Size:
    """A property of a rig, and the power of it that a parameter goes with."""

    words: str
    unit: str
    of: Callable[[Rig], float]
    reference: float
    """What the reference rig has, in ``unit``."""
    power: float = 1.0

    def __pow__(self, power: float) -> Size:
        return replace(self, power=self.power * power)

    def __str__(self) -> str:
        """The size with what it is for the reference rig.

        >>> print(MASS**-0.5)
        mass^-0.5 (280 kg)
        """
        return f"{self.words}{'' if self.power == 1 else f'^{self.power:g}'} ({self.reference:.4g} {self.unit})"

    def ratio(self, rig: Rig) -> float:
        """By how much a parameter is larger on a rig than on the reference rig."""
        return float((self.of(rig) / self.reference) ** self.power)


MASS = Size("mass", "kg", lambda rig: rig.rotor.mass_kg, 280.0)
INERTIA = Size("transverse inertia", "kg m2", lambda rig: rig.rotor.transverse_inertia_kgm2, 10.87)
SPAN = Size("distance of the bearings", "m", lambda rig: sum(rig.rotor.bearing_from_cog_m), 0.822)
BIAS = Size("bias current", "A", lambda rig: float(rig.magnets.bias_current_a.mean()), 2.75)
STIFFNESS = Size("position stiffness", "N/m", lambda rig: float(rig.magnets.ks.mean()), 1.745e6)
SLOPE = Size(
    "1/(distance of the bearings sqrt(mass))",
    "1/(m sqrt(kg))",
    lambda rig: 1 / (sum(rig.rotor.bearing_from_cog_m) * rig.rotor.mass_kg**0.5),
    0.0727,
)
AIR_GAP = Size("air gap", "m", lambda rig: float(rig.magnets.gap_m.mean()), 2.95e-4)
