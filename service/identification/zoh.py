"""Sampled-data algebra: what a zero-order hold and a sampler do to a continuous system.

The controller holds u for one sample T; i and y are read at the sampling instants. The sampled current is
therefore the exact discretisation of the amplifier, aliases of the held staircase included, while the
rotor (-40 dB per decade more) answers to the base-band part of the current alone, which is A(jw) times
`hold`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def hold(omega: Real, sample_time_s: float) -> Complex:
    """Base-band gain of a zero-order hold, Z(jw) = (1 - exp(-jwT)) / (jwT), (P,).

    >>> abs(hold(np.array([2 * np.pi * 1000.0]), 1e-4)).round(4).tolist()
    [0.9836]
    """
    half = 0.5 * omega * sample_time_s
    return np.asarray(np.sinc(half / np.pi) * np.exp(-1j * half), dtype=np.complex128)


def sampled_pole(omega: Real, pole: complex, delay_s: float, sample_time_s: float) -> tuple[Complex, Complex, Complex]:
    """Held and sampled response of 1/(s - p) exp(-s tau), with its derivatives.

    The state obeys x+ = e^{pT} x + (e^{pT} - e^{p(T-tau)})/p u_old + (e^{p(T-tau)} - 1)/p u_new; a delay of
    more than one sample, or a negative one, is split into whole samples and a remainder in [0, T).

    Parameters
    ----------
    omega
        (P,) rad/s.
    pole
        p, rad/s; not zero.
    delay_s
        tau, s.
    sample_time_s
        T, s.

    Returns
    -------
    response, d_response_d_pole, d_response_d_delay
        (P,) each.

    >>> w = np.array([100.0, 5000.0])
    >>> g, _, _ = sampled_pole(w, -2000.0, 0.0, 1e-4)
    >>> z, e = np.exp(1j * w * 1e-4), np.exp(-0.2)
    >>> np.allclose(g, (1 - e) / 2000.0 / (z - e))
    True
    """
    whole = math.floor(delay_s / sample_time_s)
    rest = sample_time_s - (delay_s - whole * sample_time_s)
    back = np.exp(-1j * omega * sample_time_s)
    shift = back**whole
    full, part = np.exp(pole * sample_time_s), np.exp(pole * rest)
    over = shift / (1.0 / back - full)
    numerator = (full - part) * back + part - 1.0
    d_numerator = (sample_time_s * full - rest * part) * back + rest * part
    response = numerator * over / pole
    d_pole = d_numerator * over / pole - response / pole + response * sample_time_s * full / (1.0 / back - full)
    d_delay = part * (back - 1.0) * over
    return response, d_pole, d_delay


def discrete_response(numerator: Real, denominator: Real, omega: Real, sample_time_s: float) -> Complex:
    """Response of a discrete transfer function, highest power of z first, at z = exp(jwT), (P,)."""
    z = np.exp(1j * omega * sample_time_s)
    return np.asarray(np.polyval(numerator, z) / np.polyval(denominator, z), dtype=np.complex128)
