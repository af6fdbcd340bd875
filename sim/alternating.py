"""Between the complex amplitudes of a signal's harmonics and its samples in time, for the nonlinear parts of a rig."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.rig import Array

Complex = NDArray[np.complex128]
Index = NDArray[np.int64]


def period_samples(X: Complex, harmonics: tuple[int, ...], n_time: int) -> Array:
    """Time samples over one period of sum Re(X_h exp(j h wt)), X (P, H, n) -> (P, n_time, n)."""
    basis = np.exp(2j * np.pi * np.outer(harmonics, np.arange(n_time)) / n_time)
    P, H, n = X.shape
    parts = np.ascontiguousarray(X.transpose(2, 0, 1), dtype=complex).view(float).reshape(n * P, 2 * H)
    real_and_imag = np.stack([basis.real, -basis.imag], axis=1).reshape(2 * H, n_time)
    # Axes outermost in memory: what an axis's own values are applied to lies in one piece.
    return np.asarray((parts @ real_and_imag).reshape(n, P, n_time).transpose(1, 2, 0))


def amplitudes(x: Array, harmonics: tuple[int, ...]) -> Complex:
    """Complex amplitudes of time samples (P, n_time, n) -> (P, H, n)."""
    P, n_time, n = x.shape
    scale = np.where(np.array(harmonics) == 0, 1.0, 2.0) / n_time
    basis = np.exp(-2j * np.pi * np.outer(np.arange(n_time), harmonics) / n_time) * scale
    parts = np.ascontiguousarray(x.transpose(2, 0, 1)).reshape(n * P, n_time) @ basis.view(float)
    return np.asarray(parts.view(complex).reshape(n, P, len(harmonics)).transpose(1, 2, 0))


def windowed_amplitudes(x: Array, angle: float, harmonics: Index) -> tuple[Complex, Complex]:
    """Complex amplitudes, (H, n), at the samples alone and with the steps between them, of x (N, steps, n).

    Samples are ``angle`` of a fundamental apart; a Hann window takes what folds back between the harmonics for nothing.
    """
    N, steps, n = x.shape
    weights = np.sin(np.pi * np.arange(N) / N) ** 2 * 4 / N
    basis = np.exp(-1j * angle * np.outer(harmonics, np.arange(N))) * weights
    basis[harmonics == 0] /= 2
    each = (basis @ x.reshape(N, steps * n)).reshape(len(harmonics), steps, n)
    within = np.exp(-1j * angle / steps * np.outer(harmonics, np.arange(steps)))
    return np.asarray(each[:, 0]), np.asarray((within[..., None] * each).mean(axis=1))


def whole_periods(samples: float, least: float, most: float) -> int:
    """Number of samples from ``least`` to about ``most`` that is nearest to whole periods of so many samples."""
    fewest = np.ceil(least / samples)
    periods = np.arange(fewest, max(fewest, np.floor(most / samples)) + 1)
    misfit = np.abs(periods * samples - np.round(periods * samples))
    return round(float(periods[np.argmin(misfit)]) * samples)
