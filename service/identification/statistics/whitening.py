"""Residuals of several channels in units of their noise, written out over the channels, vectorised over the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Complex


@dataclass(frozen=True)
class Whitener:
    """W with W cov W^H = 2 I, so that real and imaginary parts have unit variance each; lower triangular."""

    entries: tuple[tuple[int, int, Complex], ...]
    """(row, column, (P,) values) of those that are not zero at every point."""
    channels: int

    def applied(self, values: Complex) -> Complex:
        """W times (..., c, P)."""
        out = np.zeros(values.shape, dtype=np.complex128)
        self.add(values, 0, out)
        return out

    def add(self, values: Complex, first: int, out: Complex) -> None:
        """Add W times (..., k, P), the channels from ``first`` on, to (..., c, P)."""
        last = first + values.shape[-2]
        for row, column, w in self.entries:
            if first <= column < last:
                out[..., row, :] += w * values[..., column - first, :]


def whitener(covariance: Complex) -> Whitener:
    """The inverse of each covariance's Cholesky factor, from (P, c, c) Hermitian.

    Raises
    ------
    numpy.linalg.LinAlgError
        One of them is not positive definite.
    """
    c = covariance.shape[1]
    lower = _cholesky(covariance)
    inverse: dict[tuple[int, int], Complex] = {}
    for k in range(c):
        inverse[k, k] = 1.0 / lower[k, k]
        for j in range(k):
            along = sum(lower[k, m] * inverse[m, j] for m in range(j, k) if (k, m) in lower and (m, j) in inverse)
            if isinstance(along, np.ndarray):
                inverse[k, j] = -along / lower[k, k]
    root = np.sqrt(2.0)
    return Whitener(tuple((k, j, np.asarray(root * w, dtype=np.complex128)) for (k, j), w in inverse.items()), c)


def _cholesky(covariance: Complex) -> dict[tuple[int, int], Complex]:
    """Entries (P,) of the lower factors, those left out that are zero everywhere."""
    lower: dict[tuple[int, int], Complex] = {}
    for k in range(covariance.shape[1]):
        for j in range(k):
            rest = covariance[:, k, j].copy()
            for m in range(j):
                if (k, m) in lower and (j, m) in lower:
                    rest -= lower[k, m] * lower[j, m].conj()
            if np.any(rest):
                lower[k, j] = rest / lower[j, j]
        square = covariance[:, k, k].real - sum(np.abs(lower[k, m]) ** 2 for m in range(k) if (k, m) in lower)
        if not np.all(square > 0):
            raise np.linalg.LinAlgError("a covariance of the noise is not positive definite")
        lower[k, k] = np.sqrt(square)
    return lower
