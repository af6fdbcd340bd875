"""Frequency-domain subspace identification, beside the physical model, for comparison (Table 5-6).

McKelvey, Akcay and Ljung, "Subspace-based multivariable system identification from frequency response data",
IEEE TAC 41 (1996), algorithm 2: any frequencies, noise weighted by its covariance. The continuous plant is mapped on
the unit circle by the bilinear transform, so no sampling enters and unstable poles are no trouble.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.measured.etfe import FrequencyResponse
from service.identification.statistics.validation import nrmse_matrix


@dataclass(frozen=True)
class SubspaceModel:
    """Black-box continuous-time model x' = A x + B u, y = C x + D u of a measured response."""

    A: Real
    B: Real
    C: Real
    D: Real
    singular_values: Real
    """Of the weighted projection: a gap shows the order."""
    fit_percent: Real
    """(n_out, n_in) NRMSE on the data."""

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def poles(self) -> Complex:
        """rad/s."""
        return np.asarray(np.linalg.eigvals(self.A), dtype=np.complex128)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "order": self.order,
            "fit_percent": self.fit_percent.tolist(),
            "poles_rad_s": [[float(p.real), float(p.imag)] for p in self.poles],
        }

    def response(self, omega: Real) -> Complex:
        """Frequency response, (P, n_out, n_in)."""
        inner = 1j * omega[:, None, None] * np.eye(self.order) - self.A
        return np.asarray(
            self.C @ np.linalg.solve(inner, np.broadcast_to(self.B, (len(omega), *self.B.shape))) + self.D
        )


def subspace(measured: FrequencyResponse, order: int, block_rows: int | None = None) -> SubspaceModel:
    """Model of the given order from a measured frequency response.

    The number of block rows is no physical quantity, yet the fit hangs on it: unless it is given, several are tried and
    the one with the smallest residual in units of the noise is kept.

    Parameters
    ----------
    measured
        (F, p, m) with standard deviations, which weight the data.
    order
        Number of states.
    block_rows
        q.
    """
    least = order // measured.value.shape[1] + 2
    most = max(least, len(measured.omega) // 2)
    choices = [block_rows] if block_rows else sorted({min(least * k, most) for k in (1, 2, 3, 4)})
    models = [_with_block_rows(measured, order, q) for q in choices]
    return min(
        models, key=lambda m: float(np.sum(np.abs((measured.value - m.response(measured.omega)) / measured.std) ** 2))
    )


def _with_block_rows(measured: FrequencyResponse, order: int, q: int) -> SubspaceModel:
    omega, g, std = measured.omega, measured.value, measured.std
    n_lines, p, m = g.shape
    # bilinear map: the band spreads over the circle around its geometric mean
    w0 = float(np.sqrt(omega[0] * omega[-1]))
    angle = 2 * np.arctan(omega / w0)
    powers = np.exp(1j * angle[:, None] * np.arange(q))  # (F, q)

    # lines are weighted by their noise, so that loud ones do not rule
    weight = 1.0 / np.sqrt(np.mean(std**2, axis=(1, 2)) + 1e-12 * np.mean(np.abs(g) ** 2))
    weight = weight / weight.max()
    outputs = np.einsum("fq,fpm,f->qpfm", powers, g, weight).reshape(q * p, n_lines * m)
    inputs = np.einsum("fq,ab,f->qafb", powers, np.eye(m), weight).reshape(q * m, n_lines * m)
    stacked = np.concatenate([inputs, outputs])
    real = np.concatenate([stacked.real, stacked.imag], axis=1)
    lower = np.linalg.qr(real.T)[1].T
    r22 = lower[q * m :, q * m :]
    row = np.sqrt(np.sum(std**2, axis=2)) * weight[:, None]  # (F, p)
    covariance = np.zeros((q * p, q * p))
    for a in range(p):
        block = (powers.T * row[:, a] ** 2) @ powers.conj()
        covariance[a::p, a::p] = block.real
    covariance += 1e-9 * np.trace(covariance) / len(covariance) * np.eye(len(covariance))
    root = np.linalg.cholesky(covariance)
    left, singular, _ = np.linalg.svd(np.linalg.solve(root, r22), full_matrices=False)
    observability = root @ left[:, :order]
    c = observability[:p]
    a = np.linalg.lstsq(observability[:-p], observability[p:], rcond=None)[0]

    b, d = _input_matrices(a, c, np.exp(1j * angle), g, std)
    eye = np.linalg.inv(np.eye(order) + a)
    found = SubspaceModel(
        w0 * eye @ (a - np.eye(order)),
        np.sqrt(2 * w0) * eye @ b,
        np.sqrt(2 * w0) * c @ eye,
        d - c @ eye @ b,
        singular,
        np.empty(0),
    )
    return SubspaceModel(found.A, found.B, found.C, found.D, singular, nrmse_matrix(g, found.response(omega)))


def _input_matrices(a: Real, c: Real, z: Complex, g: Complex, std: Real) -> tuple[Real, Real]:
    """B and D by weighted linear least squares, A and C given."""
    n, p, m = len(a), c.shape[0], g.shape[2]
    states = c @ np.linalg.inv(z[:, None, None] * np.eye(n) - a)  # (F, p, n)
    columns = np.concatenate([states, np.broadcast_to(np.eye(p), (len(z), p, p))], axis=2)  # (F, p, n + p)
    b, d = np.empty((n, m)), np.empty((p, m))
    for j in range(m):
        weight = 1.0 / std[:, :, j]
        matrix = (columns * weight[:, :, None]).reshape(-1, n + p)
        vector = (g[:, :, j] * weight).ravel()
        real = np.concatenate([matrix.real, matrix.imag])
        scale = np.linalg.norm(real, axis=0)
        solution = np.linalg.lstsq(real / scale, np.concatenate([vector.real, vector.imag]), rcond=None)[0] / scale
        b[:, j], d[:, j] = solution[:n], solution[n:]
    return b, d
