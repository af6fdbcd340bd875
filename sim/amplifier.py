"""Current amplifiers: poles, exact sampled response to a held input, and the hold's baseband spectrum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rig import Amplifiers, Array

Complex = NDArray[np.complex128]


def continuous(amplifiers: Amplifiers, omega_rad_s: Array) -> Complex:
    """i/u per axis without delay or crosstalk, (F, n)."""
    s = 1j * np.asarray(omega_rad_s)[:, None]
    w = amplifiers.natural_frequency_rad_s
    if amplifiers.damping_ratio is None:
        return np.asarray(amplifiers.gain * w / (s + w))
    return np.asarray(amplifiers.gain * w**2 / (s**2 + 2 * amplifiers.damping_ratio * w * s + w**2))


def hold(omega_rad_s: Array, sample_time_s: float) -> Complex:
    """(1 - exp(-jwT)) / (jwT), the baseband gain of the zero-order hold, (F,)."""
    half = np.asarray(omega_rad_s) * sample_time_s / 2
    return np.asarray(np.exp(-1j * half) * np.sinc(half / np.pi))


def _step_response(amplifiers: Amplifiers, t: Array) -> Array:
    """Response to a unit step at t = 0, zero before; t of shape (..., n)."""
    w = amplifiers.natural_frequency_rad_s
    after = np.maximum(t, 0.0)
    if amplifiers.damping_ratio is None:
        response = 1 - np.exp(-w * after)
    else:
        # lambda+ and lambda- may be complex or (nearly) equal: sinh(x)/x through expm1 is smooth in both.
        z = amplifiers.damping_ratio.astype(complex)
        root = np.sqrt(z**2 - 1)
        root = np.where(np.abs(root) < 1e-6, 1e-6, root)
        plus, minus = w * (-z + root), w * (-z - root)
        response = np.real(1 + (minus * np.exp(plus * after) - plus * np.exp(minus * after)) / (plus - minus))
    return np.asarray(amplifiers.gain * np.where(t > 0, response, 0.0))


def sampled(amplifiers: Amplifiers, omega_rad_s: Array, sample_time_s: float, delay_s: Array) -> Complex:
    """Exact i/u at the sample instants when u is held, per axis without crosstalk, (F, n).

    The step response at the samples, g(kT - delay), follows a two-pole recursion after its first samples, so
    its z-transform is (g_0 + ...)/(1 - a1/z - a2/z^2) exactly, whatever the fraction of a sample in the delay.
    """
    z = np.exp(1j * np.asarray(omega_rad_s) * sample_time_s)[:, None]
    w = amplifiers.natural_frequency_rad_s
    if amplifiers.damping_ratio is None:
        poles = np.exp(-w * sample_time_s)[None, :] + 0j
    else:
        zeta = amplifiers.damping_ratio.astype(complex)
        root = np.sqrt(zeta**2 - 1)
        poles = np.exp(w * sample_time_s * np.stack([-zeta + root, -zeta - root]))
    whole = np.floor(delay_s / sample_time_s + 1e-9)
    fraction = delay_s / sample_time_s - whole
    # Impulse response of the held system h_k = g(kT - d) - g((k-1)T - d); numerator has len(poles) + 1 taps.
    taps = len(poles) + 2
    g = np.stack([_step_response(amplifiers, (k - fraction) * sample_time_s) for k in range(taps)])
    h = np.diff(g, axis=0, prepend=0.0)
    denominator = [np.ones_like(poles[0])]
    for p in poles:
        denominator = [a - p * b for a, b in zip([*denominator, 0 * p], [0 * p, *denominator], strict=True)]
    numerator = [sum(denominator[j] * h[k - j] for j in range(min(k, len(poles)) + 1)) for k in range(taps)]
    top = sum(c * z**-k for k, c in enumerate(numerator))
    bottom = sum(c * z**-k for k, c in enumerate(denominator))
    return np.asarray(top / bottom * z**-whole)
