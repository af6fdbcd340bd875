"""Sampled-data algebra: what a zero-order hold and a sampler do to a continuous system.

The controller holds u for one sample T; i and y are read at the sampling instants. The sampled current is
therefore the exact discretisation of the amplifier, aliases of the held staircase included. The rotor
(-40 dB per decade more) answers to the base-band part of the current, which is A(jw) times `hold`, and where
that counts to its first `aliases`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real

FOLDS = 0.1
"""Share of the sample rate above which a line's aliases count in y. Below, they are a ten-thousandth of it at most, and
no campaign up to 1 kHz of a controller at 10 kHz pays for them."""


def hold(omega: Real, sample_time_s: float) -> Complex:
    """Base-band gain of a zero-order hold, Z(jw) = (1 - exp(-jwT)) / (jwT), (P,).

    >>> abs(hold(np.array([2 * np.pi * 1000.0]), 1e-4)).round(4).tolist()
    [0.9836]
    """
    half = 0.5 * omega * sample_time_s
    return np.asarray(np.sinc(half / np.pi) * np.exp(-1j * half), dtype=np.complex128)


def aliases(omega: Real, sample_time_s: float) -> Iterator[tuple[NDArray[np.int64], Real]]:
    """Places of lines above `FOLDS`, and where the sampler folds onto them, rad/s: one sample rate to each side.

    A fifth of the sample rate up, they are 0.5 % of y with an amplifier of first order.

    >>> [(at.tolist(), there.round(1).tolist()) for at, there in aliases(np.array([1.0, 20.0]), 2 * np.pi / 100)]
    [([1], [-80.0]), ([1], [120.0])]
    """
    rate = 2 * np.pi / sample_time_s
    at = np.flatnonzero((omega > FOLDS * rate) & (omega < 0.5 * rate))
    if len(at):
        yield at, omega[at] - rate
        yield at, omega[at] + rate


def sampled_pole(
    omega: Real, pole: complex | Complex, delay_s: float, sample_time_s: float
) -> tuple[Complex, Complex, Complex]:
    """Held and sampled response of 1/(s - p) exp(-s tau), with its derivatives.

    The state obeys x+ = e^{pT} x + (e^{pT} - e^{p(T-tau)})/p u_old + (e^{p(T-tau)} - 1)/p u_new; a delay of
    more than one sample, or a negative one, is split into whole samples and a remainder in [0, T).

    Parameters
    ----------
    omega
        (P,) rad/s.
    pole
        p, rad/s; not zero. Several as (n, 1).
    delay_s
        tau, s.
    sample_time_s
        T, s.

    Returns
    -------
    response, d_response_d_pole, d_response_d_delay
        (P,) each, or (n, P).

    >>> w = np.array([100.0, 5000.0])
    >>> g, _, _ = sampled_pole(w, -2000.0, 0.0, 1e-4)
    >>> z, e = np.exp(1j * w * 1e-4), np.exp(-0.2)
    >>> np.allclose(g, (1 - e) / 2000.0 / (z - e))
    True
    """
    whole = math.floor(delay_s / sample_time_s)
    rest = sample_time_s - (delay_s - whole * sample_time_s)
    back = _one_sample_back(np.ascontiguousarray(omega, dtype=np.float64).tobytes(), sample_time_s)
    full, part = np.exp(pole * sample_time_s), np.exp(pole * rest)
    free = 1.0 / (1.0 / back - full)
    over = free * back**whole if whole else free
    response = ((full - part) * back + (part - 1.0)) * over / pole
    d_numerator = (sample_time_s * full - rest * part) * back + rest * part
    d_pole = d_numerator * over / pole + response * (sample_time_s * full * free - 1.0 / pole)
    d_delay = part * (back - 1.0) * over
    return response, d_pole, d_delay


@lru_cache(maxsize=64)
def _one_sample_back(omega_: bytes, sample_time_s: float) -> Complex:
    """exp(-jwT), (P,): a fit asks for the same lines at every step."""
    return np.asarray(np.exp(-1j * np.frombuffer(omega_) * sample_time_s), dtype=np.complex128)


def discrete_response(numerator: Real, denominator: Real, omega: Real, sample_time_s: float) -> Complex:
    """Response of a discrete transfer function, highest power of z first, at z = exp(jwT), (P,)."""
    z = np.exp(1j * omega * sample_time_s)
    return np.asarray(np.polyval(numerator, z) / np.polyval(denominator, z), dtype=np.complex128)
