"""What of a rotor and its sensors is held while a plane is fitted: values, and what is not known of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from service.identification.arrays import Real
from service.identification.plane.model import PlaneModel

WORDS = {
    "mass_kg": ("mass", "kg"),
    "transverse_inertia_kgm2": ("transverse inertia", "kg m²"),
    "centre_of_gravity_m": ("centre of gravity", "m"),
    "sensor_shift_A_m": ("sensor position A", "m"),
    "sensor_shift_B_m": ("sensor position B", "m"),
}
"""What a value is, and its unit; positions as changes from the datasheet's; all others are gains."""
GAINS = ("sensor_gain_A", "sensor_gain_B")


def name_in_rig(name: str, plane: str) -> str:
    """The name of a plane's value among those of its rig: a gain is each axis's own, all else is the rotor's.

    >>> name_in_rig("sensor_gain_A", "y"), name_in_rig("sensor_shift_A_m", "y")
    ('sensor_gain_yA', 'sensor_shift_A_m')
    """
    return f"sensor_gain_{plane}{name[-1]}" if name in GAINS else name


@dataclass(frozen=True)
class Given:
    """Mass, inertia, geometry and sensor gains of a plane that the data led to, within the datasheet's tolerances."""

    values: Real
    """(7,) in the order of `layout.GIVEN`."""
    covariance: Real
    """(7, 7)"""

    def of(self, model: PlaneModel) -> PlaneModel:
        """The plane with these values."""
        theta = model.theta.copy()
        theta[model.layout.given] = self.values
        return model.at(theta)


@dataclass(frozen=True)
class Adjusted:
    """A value that is held in place of the datasheet's."""

    name: str
    """As in `GIVEN`; a gain's with its axis, as ``sensor_gain_xA``."""
    value: float
    std: float
    datasheet: float
    tolerance: float
    """One sigma, in the value's unit."""

    @property
    def off(self) -> float:
        """How far from the datasheet's, in tolerances."""
        return (self.value - self.datasheet) / self.tolerance

    @property
    def in_words(self) -> str:
        """What it is."""
        return WORDS[self.name][0] if self.name in WORDS else self.name.replace("_", " ")

    @property
    def unit(self) -> str:
        """Its unit; "" for a gain."""
        return WORDS[self.name][1] if self.name in WORDS else ""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "name": self.name,
            "value": self.value,
            "std": self.std,
            "datasheet": self.datasheet,
            "tolerance": self.tolerance,
        }
