"""Where a model is evaluated, about which amplitudes, and what it says there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real
from service.identification.plane.force_law import Waves
from service.identification.plane.zoh import aliases


@dataclass(frozen=True)
class Points:
    """Where the model is evaluated: one row per excited point."""

    omega: Real
    """(P,) rad/s."""
    u: Complex
    """(P, n) A of n axes: 2 of a plane, 4 of a rotor."""

    @cached_property
    def u_rows(self) -> Complex:
        """(n, P) A: the points along memory."""
        return np.ascontiguousarray(self.u.T)

    def folding(self, sample_time_s: float) -> Folding:
        """The points with the aliases that the sampler folds onto them."""
        if sample_time_s not in self._foldings:
            self._foldings[sample_time_s] = Folding.of(self, sample_time_s)
        return self._foldings[sample_time_s]

    @cached_property
    def _foldings(self) -> dict[float, Folding]:
        return {}


@dataclass(frozen=True)
class Folding:
    """P points and behind them the aliases of the K lines that are high enough for them to count, 2 K.

    A model is evaluated at all of them at once: a few more beside a hundred cost nothing, apart they cost as much.
    """

    omega: Real
    """(P + 2 K,) rad/s; of the aliases |omega| is beyond half the sample rate."""
    u_rows: Complex
    """(n, P + 2 K) A."""
    at: NDArray[np.int64]
    """(K,) places of the lines."""
    n: int
    """P."""

    @staticmethod
    def of(points: Points, sample_time_s: float) -> Folding:
        """Of points at a controller's sample time."""
        found = list(aliases(points.omega, sample_time_s))
        places = np.concatenate([np.arange(len(points.omega)), *(at for at, _ in found)])
        omega = np.concatenate([points.omega, *(there for _, there in found)])
        return Folding(omega, points.u_rows[:, places], found[0][0] if found else places[:0], len(points.omega))

    def folded(self, values: Complex) -> Complex:
        """What the sampler makes of (..., P + 2 K), (..., P): the same memory, the aliases added."""
        out, k = values[..., : self.n], len(self.at)
        if k:
            out[..., self.at] += values[..., self.n : self.n + k]
            out[..., self.at] += values[..., self.n + k :]
        return out


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
