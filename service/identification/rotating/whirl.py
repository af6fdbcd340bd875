"""Whirl of the levitated rotor: closed-loop poles at a speed, which way they turn, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eig

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import (
    Sampled,
    block_diagonal,
    controller_states,
    driven,
    held,
    with_known_sensors,
)
from service.identification.rotating.model import RotatingModel
from service.identification.rotating.motion import Matrices

RINGING = 0.5
"""Damping ratio above which a pole is no whirl that anyone would see."""
STEP = 1e-6
"""Relative step of the derivatives of the loop's matrix, which is smooth to well below it."""


@dataclass(frozen=True)
class Whirl:
    """Oscillating poles of the loop at one speed, ascending."""

    pole: Complex
    """(n,) rad/s, Im > 0."""
    direction: Real
    """(n,) from -1, a circle from y to x at the sensors, over 0, to and fro, to 1, one from x to y."""
    shape: Complex
    """(n, 4) of the sensors' signals as sampled, of length 1."""
    covariance: Real
    """(n, 2, 2) of the pole's real and imaginary part."""

    @property
    def frequency(self) -> Real:
        """(n,) rad/s, Im of the pole: what is seen ringing."""
        return np.asarray(self.pole.imag)

    @property
    def damping_ratio(self) -> Real:
        """Of each pole, (n,)."""
        return np.asarray(-self.pole.real / np.abs(self.pole))

    @property
    def frequency_std(self) -> Real:
        """(n,) rad/s."""
        return np.asarray(np.sqrt(self.covariance[:, 1, 1]))

    @property
    def damping_std(self) -> Real:
        """(n,) of the damping ratio."""
        a, b = self.pole.real, self.pole.imag
        size = np.abs(self.pole) ** 3
        slope = np.stack([-(b**2) / size, a * b / size], axis=1)
        return np.asarray(np.sqrt(np.maximum(np.einsum("na,nab,nb->n", slope, self.covariance, slope), 0.0)))


def loop_matrix(model: RotatingModel, controller: tuple[Real, Real], speed_rad_s: float) -> tuple[Real, Real]:
    """One sample of the closed loop as a matrix, and its map from state to y as sampled; the same law in all axes."""
    plant = sampled(model, speed_rad_s)
    ca, cb, cc, cd = (block_diagonal([x] * 4) for x in controller_states(controller))
    top = np.hstack([plant.A - plant.B @ cd @ plant.C, plant.B @ cc])
    closed = np.vstack([top, np.hstack([-cb @ plant.C, ca])])
    return closed, np.hstack([plant.C, np.zeros((4, len(ca)))])


def sampled(model: RotatingModel, speed_rad_s: float) -> Sampled:
    """From u of the four axes to y at the samples, hold, delays and each sensor's dead time exact: see `held`."""
    delays_s = [p.delay_s + p.known.computing_delay_s for p in model.planes]
    dead_s = np.concatenate([k.chain.sensor_delay_s for k in model.known])
    return held(*_continuous(model, speed_rad_s), model.known[0].sample_time_s, delays_s, dead_s, keeps_all=True)


def _continuous(model: RotatingModel, speed_rad_s: float) -> tuple[Real, Real, Real]:
    """Amplifiers and rotor in a row, from u to y."""
    m = Matrices.of(model)
    n = len(m.mass)
    stiffness = np.diag(m.stiffness) + speed_rad_s * m.circulatory - m.bearings.T @ (model.ks[:, None] * m.bearings)
    damping = np.diag(m.damping) + speed_rad_s * m.gyroscopic
    rotor = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / m.mass[:, None], -damping / m.mass[:, None]]])
    push = np.vstack([np.zeros((n, 4)), m.bearings.T / m.mass[:, None] * model.ki])
    gain = np.concatenate([p.sensor_gain for p in model.planes])
    seen = np.hstack([gain[:, None] * m.sensors, np.zeros((4, n))])
    parts = [driven(p.amplifiers, p.known.chain) for p in model.planes]
    a_amp, b_amp, c_amp = (block_diagonal([x[j] for x in parts]) for j in range(3))
    size = len(a_amp)
    a = np.block([[a_amp, np.zeros((size, 2 * n))], [push @ c_amp, rotor]])
    b = np.vstack([b_amp, np.zeros((2 * n, 4))])
    # displacements and speeds in units that make the matrix even
    scale = np.concatenate([np.ones(size + n), np.full(n, 1e3)])
    c = np.hstack([np.zeros((4, size)), seen]) * scale
    bandwidth = np.concatenate([k.sensor_bandwidth_rad_s for k in model.known])
    lag_s = np.concatenate([k.chain.sensor_lag_s for k in model.known])
    return with_known_sensors(a / scale[:, None] * scale, b / scale[:, None], c, bandwidth, lag_s)


def whirl(
    model: RotatingModel,
    controller: tuple[Real, Real],
    speed_rad_s: float,
    covariance: Real,
    free: np.ndarray,
    highest_rad_s: float,
) -> Whirl:
    """Poles of the running loop at a speed that ring below a frequency, with the covariance of each."""
    matrix, seen = loop_matrix(model, controller, speed_rad_s)
    period = model.known[0].sample_time_s
    values, left, right = (np.asarray(x) for x in eig(matrix, left=True, right=True))
    poles = np.log(values + 1e-300) / period
    keep = (poles.imag > 1.0) & (poles.imag < highest_rad_s) & (-poles.real < RINGING * np.abs(poles))
    order = np.flatnonzero(keep)[np.argsort(poles.imag[keep])]
    shape = (seen @ right[:, order]).T
    shape = shape / np.linalg.norm(shape, axis=1, keepdims=True)
    x, y = shape[:, :2], shape[:, 2:]
    to_y, to_x = np.sum(np.abs(x + 1j * y) ** 2, axis=1), np.sum(np.abs(x - 1j * y) ** 2, axis=1)
    along = []
    pairing = np.einsum("ik,ik->k", left[:, order].conj(), right[:, order])
    for place in np.flatnonzero(free):
        change = _change(model, controller, speed_rad_s, matrix, int(place))
        d_value = np.einsum("ik,ik->k", left[:, order].conj(), change @ right[:, order]) / pairing
        along.append(d_value / values[order] / period)
    slope = np.array(along)  # (parameters, n)
    both = np.stack([slope.real, slope.imag], axis=2)
    found = np.einsum("pna,pq,qnb->nab", both, covariance, both)
    return Whirl(poles[order], (to_y - to_x) / (to_y + to_x), shape, found)


def _change(model: RotatingModel, controller: tuple[Real, Real], speed_rad_s: float, matrix: Real, place: int) -> Real:
    """Derivative of the loop's ``matrix`` with a parameter.

    By a step up, or down where a delay just below a whole number of samples has more states beyond it.
    """
    step = STEP * max(abs(model.theta[place]), 1e-3)
    for way in (step, -step):
        theta = model.theta.copy()
        theta[place] += way
        stepped = loop_matrix(model.at(theta), controller, speed_rad_s)[0]
        if stepped.shape == matrix.shape:
            break
    return np.asarray((stepped - matrix) / way)
