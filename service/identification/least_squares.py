"""Levenberg-Marquardt with an exact Jacobian, scaled by its columns, with a status that says why it stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr_multiply, solve_triangular

from service.identification.zoh import Real

Residual = Callable[[Real, bool], tuple[Real, Real | None] | None]
"""(theta, with Jacobian) -> (residual (N,), Jacobian (N, size) or None), or None outside the physical range."""


@dataclass(frozen=True)
class Fit:
    """Outcome of a least-squares fit."""

    theta: Real
    cost: float
    """Sum of squares."""
    residual: Real
    jacobian: Real
    """(N, n_free)"""
    free: NDArray[np.bool_]
    iterations: int
    converged: bool
    status: str

    @property
    def n_free(self) -> int:
        """Number of fitted parameters."""
        return int(self.free.sum())


def minimise(
    residual: Residual,
    theta: Real,
    free: NDArray[np.bool_],
    max_iterations: int = 60,
    tolerance: float = 1e-4,
) -> Fit:
    """Smallest sum of squares from a start.

    Parameters
    ----------
    residual
        The residuals and their Jacobian to every parameter.
    theta, free
        Start, and which parameters may move.
    max_iterations
        Accepted and refused steps together.
    tolerance
        Stop when the predicted fall of the cost is below this many units: 1e-4 is a hundredth of a standard deviation
        for residuals in units of their noise. Relative to the cost, where the model is wrong, a millionth.

    Raises
    ------
    ValueError
        The start is outside the physical range.
    """
    first = residual(theta, True)
    if first is None or first[1] is None:
        raise ValueError("the start is outside the physical range")
    r, jacobian = first[0], first[1][:, free]
    cost = float(r @ r)
    damping, growth = 1e-3, 2.0
    scale = np.zeros(int(free.sum()))
    status, converged, iteration = "iteration limit reached", False, 0
    while iteration < max_iterations:
        norms = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
        scale = np.maximum(scale * 0.3, norms)
        scale[scale == 0] = 1.0
        qtr, upper = qr_multiply(jacobian / scale, r, mode="right")
        gain = 0.0
        while iteration < max_iterations:
            iteration += 1
            step = _damped_step(upper, qtr, damping)
            predicted = float(2 * (-qtr @ (upper @ step)) - np.sum((upper @ step) ** 2))
            trial = theta.copy()
            trial[free] += step / scale
            now = residual(trial, True)
            if now is None or now[1] is None:
                damping *= growth
                growth *= 2
                continue
            new_cost = float(now[0] @ now[0])
            gain = (cost - new_cost) / predicted if predicted > 0 else -1.0
            small = predicted <= max(tolerance, 1e-6 * cost if damping < 1e-2 else 1e-9 * cost)
            if gain > 0 or (small and new_cost <= cost * (1 + 1e-9)):
                theta, r, jacobian, cost = trial, now[0], now[1][:, free], new_cost
                damping *= max(1 / 10.0, 1 - (2 * min(gain, 1.0) - 1) ** 3)
                growth = 2.0
                if small:
                    status, converged = "converged: no step lowers the cost noticeably", True
                break
            if small or damping > 1e12:
                status, converged = "converged: at the floor of rounding", True
                break
            damping *= growth
            growth *= 2
        if converged:
            break
    return Fit(theta, cost, r, jacobian, free, iteration, converged, status)


def _damped_step(upper: Real, qtr: Real, damping: float) -> Real:
    """Solution of min |R p + qtr|^2 + damping |p|^2."""
    n = upper.shape[1]
    stacked = np.vstack([upper, np.sqrt(damping) * np.eye(n)])
    q, r = np.linalg.qr(stacked)
    return np.asarray(solve_triangular(r, -(q[: len(qtr)].T @ qtr), check_finite=False))


def covariance_of(jacobian: Real) -> Real:
    """(J^T J)^-1 by singular values, with scaled columns; a direction that the data do not see gets a huge variance."""
    norms = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
    norms = np.maximum(norms, 1e-100)
    _, singular, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
    singular = np.maximum(singular, 1e-12 * singular[0])
    root = vt.T / singular
    return np.asarray(root @ root.T) / np.outer(norms, norms)
