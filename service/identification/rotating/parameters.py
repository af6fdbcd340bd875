"""The parameters of a rotor that turns: what is known of its planes, and the values of the rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane.layout import SHIFTS
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from service.identification.rotating.layout import RotatingLayout


@dataclass(frozen=True)
class RotatingParameters:
    """Both planes of a rig at any speed: what is known, where the parameters sit, and their values."""

    known: tuple[Known, Known]
    layout: RotatingLayout
    theta: Real
    """(size,)"""

    def at(self, theta: Real) -> Self:
        """The same rig with other parameters."""
        return replace(self, theta=theta)

    def plane(self, k: int) -> PlaneModel:
        """Plane ``k`` at standstill, 0 for x."""
        theta, layout = self.theta, self.layout
        gains = theta[layout.gains][2 * k : 2 * k + 2]
        # where the sensors are is known here, see `model.joined`
        own = [theta[layout.own[k]], theta[layout.rigid], gains, np.zeros(len(SHIFTS))]
        return PlaneModel(self.known[k], layout.planes[k], np.concatenate(own))

    @property
    def planes(self) -> tuple[PlaneModel, PlaneModel]:
        """Both planes at standstill."""
        return self.plane(0), self.plane(1)

    @property
    def polar_inertia(self) -> float:
        """About the shaft, kg m2."""
        return float(self.theta[self.layout.polar])

    def coupling(self, pair: int) -> tuple[float, float]:
        """Gyroscopic g, 1, and circulatory h, rad/s, of a pair: q'' + g W q' + 2 h W q between its planes."""
        at = self.layout.gyroscopic(pair)
        return float(self.theta[at]), float(self.theta[at + 1])

    @property
    def is_physical(self) -> bool:
        """Whether both planes are, and the couplings within reason."""
        gyroscopic = self.theta[self.layout.polar + 1 :: 2]
        bounded = abs(self.polar_inertia) < 3 * self.theta[self.layout.rigid][1] and np.all(np.abs(gyroscopic) < 3)
        return bool(bounded and all(p.is_physical for p in self.planes))

    def coordinate(self, plane: int, mode: int) -> int:
        """Place of a mode among the coordinates."""
        return (2 + self.layout.planes[0].n_modes) * plane + 2 + mode

    @property
    def ki(self) -> Real:
        """(4,) N/A."""
        return np.concatenate([p.ki for p in self.planes])

    @property
    def ks(self) -> Real:
        """(4,) N/m."""
        return np.concatenate([p.ks for p in self.planes])

    @property
    def bias_current_a(self) -> Real:
        """Bias currents, (4,) A."""
        return np.concatenate([k.bias_current_a for k in self.known])

    def sensor_response(self, omega: Real) -> Complex:
        """Gain and pole of the sensors, (P, 4)."""
        return np.hstack([p.sensor_response(omega) for p in self.planes])

    def amplifier_response(self, omega: Real, base_band: bool = True) -> Complex:
        """Held amplifiers with delay, base-band or sampled, (P, 4)."""
        return np.hstack([p.amplifier_response(omega, base_band) for p in self.planes])
