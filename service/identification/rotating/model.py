"""The rotor that turns: both planes of a rig together, coupled by gyroscopic moments, from u to i and y.

`motion` has the equations. At speed 0 the planes fall apart, and each is `plane.model.PlaneModel`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Amplitude, Prediction
from service.identification.plane.zoh import aliases
from service.identification.rotating.jacobian import gradients
from service.identification.rotating.layout import RotatingLayout
from service.identification.rotating.motion import Matrices, Motion, TurningPoints, inverse_dynamics
from service.identification.rotating.parameters import RotatingParameters


@dataclass(frozen=True)
class RotatingModel(RotatingParameters):
    """Both planes of a rig at any speed, as they move together."""

    def predict(self, points: TurningPoints, amplitude: Amplitude | None = None, gradient: bool = False) -> Prediction:
        """Currents and displacements at the excited lines.

        Parameters
        ----------
        points
            Frequencies, speeds and control currents.
        amplitude
            Where the force law's excess is taken, (P, 4); None for a linear magnet.
        gradient
            Whether to return the exact derivatives to every parameter.
        """
        motion = Motion.of(self, points, amplitude)
        d_i, d_y = gradients(self, points, motion) if gradient else (None, None)
        return Prediction(motion.i, motion.y, motion.coil, motion.x, d_i, d_y)

    def response(self, omega: Real, speed: Real | float) -> Complex:
        """Small-signal response G(s, W) from held u to sampled y, (P, 4, 4)."""
        speeds = np.broadcast_to(np.asarray(speed, dtype=float), omega.shape)
        out = self._base_band_response(omega, speeds)
        for at, there in aliases(omega, self.known[0].sample_time_s):
            out[at] += self._base_band_response(there, speeds[at])
        return out

    def _base_band_response(self, omega: Real, speed: Real) -> Complex:
        s: Complex = np.asarray(1j * omega, dtype=np.complex128)
        m = Matrices.of(self)
        closed = inverse_dynamics(m, self.ks, s, speed)
        plant = m.sensors @ closed @ (m.bearings.T * self.ki)
        drive = self.amplifier_response(omega)
        return np.asarray(self.sensor_response(omega)[:, :, None] * plant * drive[:, None, :])


def joined(x: PlaneModel, y: PlaneModel, pairs: tuple[tuple[int, int], ...], polar_inertia: float) -> RotatingModel:
    """Two planes, identified each by itself, as one rotor that may turn; couplings of the modes are zero."""
    layout = RotatingLayout((x.layout, y.layout), pairs)
    own = [p.theta[: p.layout.extended.start] for p in (x, y)]
    rigid = 0.5 * (x.theta[x.layout.extended][:3] + y.theta[y.layout.extended][:3])
    theta = np.concatenate([*own, rigid, x.sensor_gain, y.sensor_gain, [polar_inertia], np.zeros(2 * len(pairs))])
    known = (x.known.with_sensors_at(x.sensor_shifts_m), y.known.with_sensors_at(y.sensor_shifts_m))
    return RotatingModel(known, layout, theta)


def paired(x: PlaneModel, y: PlaneModel, relative: float = 0.05) -> tuple[tuple[int, int], ...]:
    """Modes of the two planes that are one mode of the rotor: the nearest in frequency, each once."""
    nu_x, nu_y = x.modes[:, 0], y.modes[:, 0]
    apart = np.abs(nu_x[:, None] - nu_y) / np.maximum(0.5 * (nu_x[:, None] + nu_y), 1e-12)
    pairs: list[tuple[int, int]] = []
    for place in np.argsort(apart, axis=None):
        a, b = (int(v) for v in np.unravel_index(place, apart.shape))
        if apart[a, b] < relative and all(a != i and b != j for i, j in pairs):
            pairs.append((a, b))
    return tuple(sorted(pairs))
