"""Where a measured response has lightly damped peaks, and which frequencies resolve them.

Between two neighbours of a log-spaced grid a peak of a rotor's flexible mode can hide: at 500 Hz and a damping of
0.001 it is 1 Hz wide, the grid's step 11 Hz. Its flanks show it all the same: in a window of a few points the
response is one complex pole and a smooth background, so a local rational fit tells where the pole is. Points are added
at the pole, the fit is repeated with them, and so on until the pole stands still.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

WINDOW = 8
"""Points of a local fit: one pole and a background of second order leave enough of them over to be judged."""
BACKGROUND = 2
ITERATIONS = 8
PROMINENCE = 1.0
"""A peak at least as high as what it stands on."""
SHARP = 0.02
"""Damping ratio of a peak that counts even where points are so dense that a window is narrower than the peak."""
UNEXPLAINED = 3.0
"""Residual of a smooth polynomial, in standard deviations, above which a window needs a pole."""
FLANK = 2.0
"""Beyond the half-power width the distance from the peak grows by this factor from point to point."""


SMALLEST = 1e-9
"""Smallest deviation that is allowed for, relative to the largest response."""


@dataclass(frozen=True)
class Peak:
    """A pole of the response near the imaginary axis."""

    frequency_hz: float
    half_width_hz: float
    """Half of the half-power width: damping ratio times frequency."""
    prominence: float
    """Height of the pole's term over the background, at its frequency."""


@dataclass(frozen=True)
class LocalPoles:
    """Local fits of W windows: G = (n0 + n1 x + n2 x^2) / (x - p), x real frequency."""

    pole_hz: Complex
    """(W,) the peak's frequency and, as imaginary part, its half-width."""
    prominence: Real
    """(W,) norm of the pole's term over the norm of the background, at the pole's frequency."""
    residual: Real
    """(W,) root mean square of the fit's residual, in standard deviations."""
    polynomial: Real
    """(W,) the same of a polynomial of third order, which has as many coefficients but no pole."""


def _powers(x: NDArray[Any], order: int) -> Complex:
    return np.stack([x**k for k in range(order + 1)], axis=-1).astype(np.complex128)


def local_poles(frequency_hz: Real, response: Complex, deviation: Real) -> LocalPoles:
    """Poles of local models by iterated linear least squares (Sanathanan and Koerner, IEEE Trans. AC-8, 1963).

    Parameters
    ----------
    frequency_hz
        (W, K) windows of rising frequencies.
    response
        (W, E, K) entries that share the pole.
    deviation
        (W, E, K) standard deviations.
    """
    middle = frequency_hz.mean(axis=1, keepdims=True)
    scale = np.ptp(frequency_hz, axis=1, keepdims=True) / 2
    x = (frequency_hz - middle) / scale
    closest = 1e-3 * np.min(np.diff(x, axis=1), axis=1, keepdims=True)
    basis = _powers(x, BACKGROUND)[:, None]
    pole = np.zeros((len(x), 1), dtype=np.complex128)
    weight = np.ones(x.shape)
    for _ in range(ITERATIONS):
        w = weight[:, None] / deviation
        q, _ = np.linalg.qr(basis * w[..., None])
        left = np.stack([w * response, w * x[:, None] * response], axis=-1)
        left = left - q @ (np.conj(np.swapaxes(q, -1, -2)) @ left)
        g, xg = left[..., 0], left[..., 1]
        below = np.sum(np.abs(g) ** 2, axis=(1, 2))
        pole = (np.sum(np.conj(g) * xg, axis=(1, 2)) / np.where(below > 0, below, 1.0))[:, None]
        weight = 1 / np.maximum(np.abs(x - pole), closest)
    separate = np.where(np.abs(x - pole) < 1e-9, 1e-9, x - pole)
    term = np.concatenate([1 / separate[..., None], _powers(x, BACKGROUND - 1)], axis=-1)[:, None]
    coefficients, residual = _fit(term, response, deviation)
    _, polynomial = _fit(_powers(x, BACKGROUND + 1)[:, None], response, deviation)
    height = np.abs(coefficients[..., 0]) / np.maximum(np.abs(pole.imag), 1e-12)
    background = np.abs(np.sum(coefficients[..., 1:] * _powers(pole.real, BACKGROUND - 1), axis=-1))
    prominence = np.linalg.norm(height, axis=1) / np.maximum(np.linalg.norm(background, axis=1), 1e-300)
    return LocalPoles(
        pole_hz=(middle + scale * pole.real + 1j * scale * np.abs(pole.imag))[:, 0],
        prominence=prominence,
        residual=residual,
        polynomial=polynomial,
    )


def _fit(columns: Complex, response: Complex, deviation: Real) -> tuple[Complex, Real]:
    """Weighted least squares of every entry: coefficients (W, E, c), rms residual (W,) in standard deviations."""
    weighted = columns / deviation[..., None]
    q, r = np.linalg.qr(weighted)
    target = (response / deviation)[..., None]
    projected = np.conj(np.swapaxes(q, -1, -2)) @ target
    rest = (target - q @ projected)[..., 0]
    residual: Real = np.sqrt(np.mean(np.abs(rest) ** 2, axis=(1, 2)))
    # Not solve: where the rotor touches, an entry may be all noise, and its columns depend on each other.
    return (np.linalg.pinv(r) @ projected)[..., 0], residual


def peaks(frequency_hz: Real, response: Complex, deviation: Real, floor: float) -> list[Peak]:
    """Lightly damped peaks of a response, found window by window.

    Parameters
    ----------
    frequency_hz
        (F,) rising, no frequency twice.
    response
        (F, E) entries that share their poles.
    deviation
        (F, E) standard deviations.
    floor
        Relative model error to allow for besides noise: the background is no exact polynomial.

    Returns
    -------
    peaks
        Rising. A pole counts when it lies between the window's two middle points (so that each is counted once),
        is sharp or narrower than the window, stands above the background, and explains what a polynomial does not.
    """
    if len(frequency_hz) < WINDOW:
        return []
    size = np.linalg.norm(response, axis=1, keepdims=True)
    if not np.any(size):
        return []
    # A log of few bits may show nothing at all where the rotor hardly moves: no exact nought either.
    allowed = np.maximum(np.hypot(deviation, floor * size / np.sqrt(response.shape[1])), SMALLEST * size.max())
    f = np.lib.stride_tricks.sliding_window_view(frequency_hz, WINDOW)
    windows = (np.lib.stride_tricks.sliding_window_view(a, WINDOW, axis=0) for a in (response, allowed))
    fit = local_poles(f, *windows)
    # at the ends of the sweep the first and last windows answer for all of their half
    low, high = f[:, WINDOW // 2 - 1].copy(), f[:, WINDOW // 2].copy()
    low[0], high[-1] = f[0, 0], f[-1, -1]
    p = fit.pole_hz
    # a pole on a measured frequency must not fall between two windows that each see it on the other's side
    slack = np.minimum(0.25 * (high - low), 0.3 * p.imag)
    narrow = p.imag < np.maximum(np.ptp(f, axis=1) / 2, SHARP * np.abs(p.real))
    good = (low - slack <= p.real) & (p.real < high + slack) & narrow & (fit.prominence > PROMINENCE)
    good &= (fit.polynomial > UNEXPLAINED) & (fit.residual < fit.polynomial / 2)
    return merged(Peak(float(p[k].real), float(p[k].imag), float(fit.prominence[k])) for k in np.flatnonzero(good))


def merged(found: Iterable[Peak]) -> list[Peak]:
    """Peaks without doubles: of two closer than the narrower one's half-width the narrower stays."""
    kept: list[Peak] = []
    for peak in sorted(found, key=lambda p: p.half_width_hz):
        if all(abs(peak.frequency_hz - k.frequency_hz) > 0.5 * k.half_width_hz for k in kept):
            kept.append(peak)
    return sorted(kept, key=lambda p: p.frequency_hz)


def resolved(peak: Peak, frequency_hz: Real, wanted: int) -> bool:
    """Whether enough measured points lie within the peak's half-power width."""
    distance = np.abs(frequency_hz - peak.frequency_hz)
    return int(np.sum(distance <= 1.05 * peak.half_width_hz)) >= wanted


def densification(peak: Peak, frequency_hz: Real, wanted: int) -> Real:
    """Frequencies to add: ``wanted`` across the half-power width, then out along both flanks until the grid takes over.

    A frequency that is close to one already measured (a third of the local step) is left out.
    """
    f0, half = peak.frequency_hz, peak.half_width_hz
    offsets = list(np.linspace(-0.9, 0.9, wanted) * half)
    steps = [1.8 * half / (wanted - 1)] * len(offsets)
    distance = FLANK * half
    gaps = np.diff(frequency_hz)
    k = int(np.clip(np.searchsorted(frequency_hz, f0) - 1, 0, len(gaps) - 1))
    reach = float(np.max(gaps[max(0, k - 1) : k + 2]))
    while distance < reach:
        offsets += [-distance, distance]
        steps += [distance / 2] * 2
        distance *= FLANK
    new: list[float] = []
    for offset, step in sorted(zip(offsets, steps, strict=True), key=lambda pair: abs(pair[0])):
        f = f0 + offset
        taken = np.concatenate([frequency_hz, np.array(new)])
        if frequency_hz[0] <= f <= frequency_hz[-1] and np.min(np.abs(taken - f)) > step / 3:
            new.append(f)
    return np.sort(np.array(new))
