"""Model of one current amplifier: dc gain, real poles or pole pairs, and the delay before it.

Order 1 is gain w/(s + w), order 2 gain w^2/(s^2 + 2 zeta w s + w^2), order 3 the second with one more lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real
from service.identification.plane.zoh import hold, sampled_pole

N_PARAMETERS = {1: 2, 2: 3, 3: 4}
"""Parameters by order: (gain, w), (gain, w, zeta), (gain, w, zeta, lag frequency)."""

PARAMETER_NAMES = ("gain", "natural_frequency_rad_s", "damping_ratio", "lag_rad_s")


@dataclass(frozen=True)
class Amplifier:
    """An amplifier without its delay. ``parameters``: see `N_PARAMETERS`."""

    parameters: tuple[float, ...]

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.parameters) - 1

    @property
    def dc_gain(self) -> float:
        """i/u at zero frequency."""
        return self.parameters[0]

    @property
    def poles(self) -> NDArray[np.complex128]:
        """(order,) rad/s."""
        return poles_of(np.asarray(self.parameters))[0]


def poles_of(parameters: Real) -> tuple[Complex, Complex]:
    """Poles and their derivatives to the parameters beyond the gain.

    Returns
    -------
    poles, gradient
        (n,) and (n, n), rad/s and per parameter.
    """
    order = len(parameters) - 1
    w = parameters[1]
    if order == 1:
        return np.array([-w], dtype=complex), np.array([[-1.0]], dtype=complex)
    zeta = parameters[2]
    if abs(zeta - 1.0) < 1e-7:  # a double pole has no partial fractions
        zeta = 1.0 + 1e-7
    root = np.sqrt(complex(zeta**2 - 1.0))
    pair = np.array([-zeta + root, -zeta - root])
    poles = np.zeros(order, dtype=complex)
    gradient = np.zeros((order, order), dtype=complex)
    poles[:2] = w * pair
    gradient[:2, 0] = pair
    gradient[:2, 1] = w * np.array([-1.0 + zeta / root, -1.0 - zeta / root])
    if order == 3:
        poles[2] = -parameters[3]
        gradient[2, 2] = -1.0
    return poles, gradient


def base_band(omega: Real, parameters: Real, delay_s: float, sample_time_s: float) -> tuple[Complex, Complex]:
    """Current in the coil at the excited line per ampere of held u, with its derivatives.

    Returns
    -------
    response, gradient
        (P,) and (P, n + 2): to the parameters in order, then to the delay. Read-only: asked for again, the same arrays.
    """
    return _base_band(_bytes(omega), _bytes(parameters), delay_s, sample_time_s)


@lru_cache(maxsize=64)
def _base_band(omega_: bytes, parameters_: bytes, delay_s: float, sample_time_s: float) -> tuple[Complex, Complex]:
    omega, parameters = np.frombuffer(omega_), np.frombuffer(parameters_)
    s, held = _at_lines(omega_, sample_time_s)
    poles, d_poles = poles_of(parameters)
    away = 1.0 / (s - poles[:, None])
    response = np.asarray(parameters[0] * np.prod(-poles[:, None] * away, axis=0) * np.exp(-s * delay_s) * held)
    gradient = np.empty((len(parameters) + 1, len(omega)), dtype=complex)
    gradient[0] = response / parameters[0]
    gradient[1:-1] = response * (d_poles.T @ (1.0 / poles[:, None] + away))
    gradient[-1] = -s * response
    return _frozen(response, gradient.T)


@lru_cache(maxsize=64)
def _at_lines(omega_: bytes, sample_time_s: float) -> tuple[Complex, Complex]:
    """s and the hold's gain at the lines, (P,) each: no fit moves them."""
    omega = np.frombuffer(omega_)
    return np.asarray(1j * omega, dtype=np.complex128), hold(omega, sample_time_s)


def sampled(omega: Real, parameters: Real, delay_s: float, sample_time_s: float) -> tuple[Complex, Complex]:
    """Sampled current per ampere of held u: the exact discretisation, with its derivatives.

    Returns
    -------
    response, gradient
        As `base_band`.
    """
    return _sampled(_bytes(omega), _bytes(parameters), delay_s, sample_time_s)


@lru_cache(maxsize=64)
def _sampled(omega_: bytes, parameters_: bytes, delay_s: float, sample_time_s: float) -> tuple[Complex, Complex]:
    omega, parameters = np.frombuffer(omega_), np.frombuffer(parameters_)
    poles, d_poles = poles_of(parameters)
    n = len(poles)
    itself = np.eye(n)
    apart = poles[:, None] - poles + itself
    residues = parameters[0] * np.prod(-poles) / np.prod(apart, axis=1)
    inverse = (1.0 - itself) / apart
    f, d_f, d_delay = sampled_pole(omega, poles[:, None], delay_s, sample_time_s)
    parts = residues[:, None] * f
    response = parts.sum(axis=0)
    d_log = 1.0 / poles + inverse - itself * inverse.sum(axis=1)  # residue k, its row, moves with every pole
    gradient = np.empty((len(parameters) + 1, len(omega)), dtype=complex)
    gradient[0] = response / parameters[0]
    gradient[1:-1] = (d_poles.T * residues) @ d_f + (d_log @ d_poles).T @ parts
    gradient[-1] = residues @ d_delay
    return _frozen(response, gradient.T)


def _bytes(values: Real) -> bytes:
    return np.ascontiguousarray(values, dtype=np.float64).tobytes()


def _frozen(response: Complex, gradient: Complex) -> tuple[Complex, Complex]:
    response.flags.writeable = False
    gradient.flags.writeable = False
    return response, gradient
