"""Where a model is evaluated, about which amplitudes, and what it says there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.identification.force_law import Waves
from service.identification.zoh import Complex, Real


@dataclass(frozen=True)
class Points:
    """Where the model is evaluated: one row per excited point."""

    omega: Real
    """(P,) rad/s."""
    u: Complex
    """(P, 2) A."""

    @cached_property
    def u_rows(self) -> Complex:
        """(2, P) A: the points along memory."""
        return np.ascontiguousarray(self.u.T)


@dataclass(frozen=True)
class Together:
    """Which points of a multisine excite the rotor at the same time, where its phases are not known."""

    group: NDArray[np.int64]
    """(P,)"""
    kurtosis: Real
    """(n_axes,) of the displacement, 1 for Gaussian."""


@dataclass(frozen=True)
class Amplitude:
    """Amplitudes at the bearings about which the force law's excess is taken."""

    current: Complex
    """(P, 2) A."""
    displacement: Complex
    """(P, 2) m."""
    together: Together | None = None
    """Of a multisine without phases; None for tones."""
    products: Complex | None = None
    """(B, 3, P, 2) of a multisine, whose lines are there at once: `many_lines.ManyLines.products`; None for tones."""

    @cached_property
    def waves(self) -> Waves:
        """Half a period of either."""
        return Waves.of(self.current, self.displacement)


@dataclass(frozen=True)
class Prediction:
    """What a model says at each point; n is 2 for a plane and 4 for a rotor. Gradients are None when not asked for."""

    i: Complex
    """(P, n) sampled current, A."""
    y: Complex
    """(P, n) sampled displacement at the sensors, m."""
    coil: Complex
    """(P, n) base-band current, A."""
    x: Complex
    """(P, n) displacement at the bearings, m."""
    d_i: Complex | None = None
    """(P, n, size)"""
    d_y: Complex | None = None
    """(P, n, size)"""
