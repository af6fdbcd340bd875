"""Where the parameters of a plane's model sit in one vector, and what they are called."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.identification.plane import amplifier

MODE_NAMES = ("nu_rad_s", "sigma_rad_s", "bearing_A", "bearing_B", "sensor_A", "sensor_B")
N_MODE = len(MODE_NAMES)
EXTENDED = ("mass_kg", "transverse_inertia_kgm2", "centre_of_gravity_m", "sensor_gain_A", "sensor_gain_B")
"""Mass, inertia, centre of gravity (its shift towards bearing A) and sensor gains: which of them data can tell is
reported."""
SHIFTS = ("sensor_shift_A_m", "sensor_shift_B_m")
"""How much farther from the centre the sensors are than the datasheet says."""
GIVEN = (*EXTENDED, *SHIFTS)
"""Parameters that are known from the datasheet unless they are asked for."""


@dataclass(frozen=True)
class Layout:
    """Where each parameter sits in the vector: ki, ks, amplifiers, delay, modes, what is given."""

    amplifier_orders: tuple[int, int] = (2, 2)
    n_modes: int = 0

    @cached_property
    def amplifiers(self) -> tuple[slice, slice]:
        """Places of the two amplifiers' parameters."""
        a, b = (amplifier.N_PARAMETERS[n] for n in self.amplifier_orders)
        return slice(4, 4 + a), slice(4 + a, 4 + a + b)

    @cached_property
    def delay(self) -> int:
        """Place of the delay."""
        return int(self.amplifiers[1].stop)

    def mode(self, k: int) -> slice:
        """Places of mode ``k``, in the order of `MODE_NAMES`."""
        start = self.delay + 1 + N_MODE * k
        return slice(start, start + N_MODE)

    @cached_property
    def extended(self) -> slice:
        """Places of the extended set, in the order of `EXTENDED`."""
        start = self.delay + 1 + N_MODE * self.n_modes
        return slice(start, start + len(EXTENDED))

    @cached_property
    def given(self) -> slice:
        """Places of all that is known from the datasheet unless it is asked for, in the order of `GIVEN`; the last."""
        return slice(self.extended.start, self.extended.start + len(GIVEN))

    @cached_property
    def shifts(self) -> slice:
        """Places of `SHIFTS`."""
        return slice(self.extended.stop, self.given.stop)

    @cached_property
    def size(self) -> int:
        """Length of the parameter vector."""
        return int(self.given.stop)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        names = ["ki_A", "ki_B", "ks_A", "ks_B"]
        for axis, order in zip("AB", self.amplifier_orders, strict=True):
            names += [f"amplifier_{axis}_{n}" for n in amplifier.PARAMETER_NAMES[: amplifier.N_PARAMETERS[order]]]
        names.append("delay_s")
        for k in range(self.n_modes):
            names += [f"mode_{k + 1}_{n}" for n in MODE_NAMES]
        return (*names, *GIVEN)

    def index(self, name: str) -> int:
        """Place of a parameter by name."""
        return self.names.index(name)

    def free(self, *given: str, fixed: tuple[str, ...] = ()) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(size,) True for every parameter that a fit may move: all but what is given and ``fixed``."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.given] = [n in given for n in GIVEN]
        for name in fixed:
            mask[self.index(name)] = False
        return mask
