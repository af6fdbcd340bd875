"""Between the complex amplitudes of a signal's harmonics and its samples in time, for the nonlinear parts of a rig."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

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


@dataclass(frozen=True)
class Record:
    """The harmonics of samples that lie ``angle`` of a fundamental apart: any number of them, also none per period.

    ``before`` samples precede the ``n`` that are analysed.
    """

    angle: float
    harmonics: tuple[int, ...]
    before: int
    n: int

    @staticmethod
    @lru_cache(maxsize=256)
    def of(angle: float, harmonics: tuple[int, ...], before: int, n: int) -> Record:
        """One that is shared, as a fit asks for the same lines again and again."""
        return Record(angle, harmonics, before, n)

    @cached_property
    def _turns(self) -> Complex:
        return np.asarray(np.exp(1j * self.angle * np.outer(np.arange(-self.before, self.n), self.harmonics)))

    @cached_property
    def _window(self) -> Array:
        """Real and imaginary parts of what amplitudes weigh the samples with, (2 H, n).

        A Hann window takes what folds back between the harmonics for nothing.
        """
        weights = np.sin(np.pi * np.arange(self.n) / self.n) ** 2 * 4 / self.n
        basis = self._turns[self.before :].conj().T * weights
        basis[np.array(self.harmonics) == 0] /= 2
        return np.concatenate([basis.real, basis.imag])

    def samples(self, X: Complex) -> Array:
        """Samples, (before + n, axes), of amplitudes (H, axes); the first one analysed is at time zero."""
        return np.asarray(self._turns.real @ X.real - self._turns.imag @ X.imag)

    def amplitudes(self, x: Array) -> tuple[Complex, Complex]:
        """Complex amplitudes, (H, axes), at the samples alone and with the steps between them, of (n, steps, axes)."""
        N, steps, axes = x.shape
        real, imag = (self._window @ x.reshape(N, steps * axes)).reshape(2, -1, steps, axes)
        each, orders = real + 1j * imag, np.array(self.harmonics)
        within = np.exp(-1j * self.angle / steps * np.outer(orders, np.arange(steps)))
        return each[:, 0], np.asarray((within[..., None] * each).mean(axis=1))


def whole_periods(samples: float, least: float, most: float) -> int:
    """Number of samples from ``least`` to about ``most`` that is nearest to whole periods of so many samples."""
    fewest = np.ceil(least / samples)
    periods = np.arange(fewest, max(fewest, np.floor(most / samples)) + 1)
    misfit = np.abs(periods * samples - np.round(periods * samples))
    return round(float(periods[np.argmin(misfit)]) * samples)
