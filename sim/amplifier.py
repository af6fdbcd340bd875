"""Current amplifiers: poles, exact sampled response to a held input, and the hold's baseband spectrum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.remember import remembered
from sim.rig import Amplifiers, Array

Complex = NDArray[np.complex128]

FELT_LAG_S = 1e-15
"""A further lag below this is none: far less than a fit's step of it, and its pole would leave the range of numbers."""


@remembered(32)
def continuous(amplifiers: Amplifiers, omega_rad_s: Array) -> Complex:
    """i/u per axis without delay or crosstalk, (F, n)."""
    s = 1j * np.asarray(omega_rad_s)[:, None]
    w, lag = amplifiers.natural_frequency_rad_s, 1 + s * amplifiers.lag_s
    if amplifiers.damping_ratio is None:
        return np.asarray(amplifiers.gain * w / (s + w) / lag)
    return np.asarray(amplifiers.gain * w**2 / (s**2 + 2 * amplifiers.damping_ratio * w * s + w**2) / lag)


def poles(amplifiers: Amplifiers) -> Complex:
    """Poles of each axis, (order, n), rad/s, kept apart where two coincide."""
    w = amplifiers.natural_frequency_rad_s
    if amplifiers.damping_ratio is None:
        own = [-w + 0j]
    else:
        zeta = amplifiers.damping_ratio.astype(complex)
        root = np.sqrt(zeta**2 - 1)
        root = np.where(np.abs(root) < 1e-6, 1e-6, root)
        own = [w * (-zeta + root), w * (-zeta - root)]
    if amplifiers.lag_s > FELT_LAG_S:
        lag = np.full(len(w), -1 / amplifiers.lag_s + 0j)
        for p in own:
            lag = np.where(np.abs(lag / p - 1) < 1e-5, lag * (1 + 1e-5), lag)
        own.append(lag)
    return np.stack(own)


def hold(omega_rad_s: Array, sample_time_s: float) -> Complex:
    """(1 - exp(-jwT)) / (jwT), the baseband gain of the zero-order hold, (F,)."""
    half = np.asarray(omega_rad_s) * sample_time_s / 2
    return np.asarray(np.exp(-1j * half) * np.sinc(half / np.pi))


def _step_response(gain: Array, own: Complex, t: Array) -> Array:
    """Response to a unit step at t = 0, zero before; t of shape (K, n). Partial fractions of A(s) / s.

    ``own`` are the poles, (order, n).
    """
    after = np.maximum(t, 0.0)
    response = np.ones(t.shape, dtype=complex)
    for k, pole in enumerate(own):
        weight = -np.ones(own.shape[1], dtype=complex)
        for j, other in enumerate(own):
            if j != k:
                weight = weight * -other / (pole - other)
        response += weight * np.exp(pole * after)
    return np.asarray(gain * np.where(t > 0, response.real, 0.0))


@remembered(16)
def sampled(amplifiers: Amplifiers, omega_rad_s: Array, sample_time_s: float, delay_s: Array) -> Complex:
    """Exact i/u at the sample instants when u is held, per axis without crosstalk, (F, n).

    The step response at the samples, g(kT - delay), follows a recursion of the amplifier's order after its first
    samples, so its z-transform is a ratio of polynomials exactly, whatever the fraction of a sample in the delay.
    """
    own = poles(amplifiers)
    angle = np.asarray(omega_rad_s)[:, None] * sample_time_s
    back = np.exp(-1j * angle)  # a sample of delay, z^-1
    whole = np.floor(delay_s / sample_time_s + 1e-9)
    fraction = delay_s / sample_time_s - whole
    # Impulse response of the held system h_k = g(kT - d) - g((k-1)T - d), two taps more than poles.
    taps = np.arange(len(own) + 2)[:, None]
    numerator = np.diff(_step_response(amplifiers.gain, own, (taps - fraction) * sample_time_s), axis=0, prepend=0.0)
    bottom = np.ones((len(back), len(whole)), dtype=complex)
    for pole in np.exp(own * sample_time_s):
        numerator = numerator - pole * np.concatenate([np.zeros_like(numerator[:1]), numerator[:-1]])
        bottom *= 1 - pole * back
    top = np.zeros_like(bottom)
    for coefficient in numerator[::-1]:
        top = top * back + coefficient
    return np.asarray(top / bottom * np.exp(-1j * angle * whole))
