"""Where the parameters of a rotor that turns sit in one vector, and what they are called."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.identification.plane.layout import Layout

RIGID = ("mass_kg", "transverse_inertia_kgm2", "centre_of_gravity_m")
GAINS = ("sensor_gain_xA", "sensor_gain_xB", "sensor_gain_yA", "sensor_gain_yB")
POLAR = "polar_inertia_kgm2"


@dataclass(frozen=True)
class RotatingLayout:
    """Where each parameter sits: plane x, plane y, the rigid body, sensor gains, polar inertia, couplings of modes."""

    planes: tuple[Layout, Layout]
    pairs: tuple[tuple[int, int], ...] = ()
    """(mode of x, mode of y) that are one mode of the rotor in its two planes."""

    @cached_property
    def own(self) -> tuple[slice, slice]:
        """Places of what belongs to one plane, in the order of its own layout."""
        x, y = (p.extended.start for p in self.planes)
        return slice(0, x), slice(x, x + y)

    @cached_property
    def rigid(self) -> slice:
        """Places of `RIGID`."""
        start = int(self.own[1].stop)
        return slice(start, start + 3)

    @cached_property
    def gains(self) -> slice:
        """Places of the four sensor gains."""
        return slice(self.rigid.stop, self.rigid.stop + 4)

    @property
    def polar(self) -> int:
        """Place of the polar inertia."""
        return int(self.gains.stop)

    def gyroscopic(self, pair: int) -> int:
        """Place of the gyroscopic coupling g of a pair; its circulatory coupling h follows."""
        return self.polar + 1 + 2 * pair

    @property
    def size(self) -> int:
        """Length of the parameter vector."""
        return self.polar + 1 + 2 * len(self.pairs)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        names = [f"{p}_{n}" for p, layout in zip("xy", self.planes, strict=True) for n in _own_names(layout)]
        names += [*RIGID, *GAINS, POLAR]
        for k in range(len(self.pairs)):
            names += [f"pair_{k + 1}_gyroscopic", f"pair_{k + 1}_rotating_damping_rad_s"]
        return tuple(names)

    def index(self, name: str) -> int:
        """Place of a parameter by name."""
        return self.names.index(name)

    def free(self) -> NDArray[np.bool_]:
        """(size,) True for what a joint fit moves: all but the mass and the sensors' gains."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.gains] = False
        mask[self.index("mass_kg")] = False
        return mask


def _own_names(layout: Layout) -> tuple[str, ...]:
    return layout.names[: layout.extended.start]
