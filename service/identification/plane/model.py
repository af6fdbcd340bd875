"""The physical model of one plane, from u to i and y, with its exact derivatives.

u is held, delayed, amplified: i = A u, f = Ki i + Ks x_b + (what the force law adds at this amplitude). The rotor is
the free one, rigid and flexible modes with unit modal mass: x_b = H_bb f, y = H_sb f, with
H = Phi diag(1/(s^2 + 2 sigma s + w^2)) Phi_b^T. Eliminating f gives y = H_sb (I - Ks H_bb)^-1 Ki i, the thesis's
eq. 4.9 with the exact sensor map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane.jacobian import gradients
from service.identification.plane.motion import Motion, loop_of
from service.identification.plane.parameters import PlaneParameters
from service.identification.plane.prediction import Amplitude, Points, Prediction
from service.identification.plane.zoh import aliases


@dataclass(frozen=True)
class PlaneModel(PlaneParameters):
    """A plane as its parts move together."""

    def predict(self, points: Points, amplitude: Amplitude | None = None, gradient: bool = False) -> Prediction:
        """Currents and displacements at the excited lines.

        Parameters
        ----------
        points
            Frequencies and control currents.
        amplitude
            Where the force law's excess is taken; None for a linear magnet.
        gradient
            Whether to return the derivatives to every parameter.
        """
        motion = self.motion(points, amplitude, gradient)
        d_i, d_y = None, None
        if gradient:
            d_i, d_y = (d.transpose(2, 1, 0) for d in gradients(self, points, motion))
        return Prediction(motion.i.T, motion.y.T, motion.coil.T, motion.x.T, d_i, d_y)

    def motion(self, points: Points, amplitude: Amplitude | None = None, slopes: bool = False) -> Motion:
        """The same with what it follows from, the points last; ``slopes``: as derivatives need them."""
        return Motion.of(self, points, amplitude, slopes)

    def plant_response(self, omega: Real) -> Complex:
        """Small-signal plant from coil current to sensed displacement, (P, 2, 2)."""
        through = loop_of(self, omega).through
        return np.asarray((through * self.ki[:, None]).transpose(2, 0, 1))

    def response(self, omega: Real) -> Complex:
        """Small-signal response from held u, as it reaches the amplifiers, to sampled y, (P, 2, 2)."""
        out = self._base_band_response(omega)
        for at, there in aliases(omega, self.known.sample_time_s):
            out[at] += self._base_band_response(there)
        return out

    def _base_band_response(self, omega: Real) -> Complex:
        return np.asarray(self.plant_response(omega) * self.amplifier_response(omega)[:, None, :])
