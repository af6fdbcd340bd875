"""Levenberg-Marquardt with an exact Jacobian, scaled by its columns, with a status that says why it stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr_multiply
from scipy.linalg.lapack import dpotrf, dtrtrs

from service.identification.arrays import Real

Residual = Callable[[Real, bool], tuple[Real, Real | None] | None]
"""(theta, with Jacobian) -> (residual (N,), Jacobian or None), or None outside the physical range. The Jacobian is
(N, size), or (N, n) to the n parameters that may move."""
DONE = "converged: no step lowers the cost noticeably"
LINEAR = 1e-3
"""Relative change of every parameter up to which a last step that hardly lowers the cost is not evaluated any more."""
CLEAR = 1e-4
"""Least pivot of scaled columns that a Cholesky factor of their products still tells to eight digits."""


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
    def doubt(self) -> tuple[str, ...]:
        """What there is to say of a search that did not end by itself, in a sentence."""
        if self.converged:
            return ()
        return (
            f"the search for the best parameters did not end ({self.status}): figures may be off by more than their "
            "standard deviations tell; begin closer, with a datasheet that is nearer to the rig, or measure more",
        )

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
    damping: float = 1e-3,
    physical: Callable[[Real], bool] | None = None,
    moved: Callable[[Real, Real], Real] | None = None,
) -> Fit:
    """Smallest sum of squares from a start.

    Parameters
    ----------
    residual
        The residuals and their Jacobian.
    theta, free
        Start, and which parameters may move.
    max_iterations
        Accepted and refused steps together.
    tolerance
        Stop when the predicted fall of the cost is below this many units: 1e-4 is a hundredth of a standard deviation
        for residuals in units of their noise. Relative to the cost, where the model is wrong, a millionth.
    damping
        That of the first step, in units of the columns' squares. A direction that the data hardly tell is held by it.
    physical
        Whether parameters are within the physical range, where that can be told without the residuals: a last step that
        changes nothing but digits is then taken without them.
    moved
        Where a step leads from some parameters, (size,) each, where a straight line leaves a bent valley; to first
        order their sum.

    Raises
    ------
    ValueError
        The start is outside the physical range.
    """
    first = residual(theta, True)
    if first is None or first[1] is None:
        raise ValueError("the start is outside the physical range")
    n = int(free.sum())
    r, jacobian = first[0], _moving(first[1], free)
    cost = float(r @ r)
    growth = 2.0
    scale = np.zeros(n)
    status, converged, iteration = "iteration limit reached", False, 0
    while iteration < max_iterations:
        norms = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
        scale = np.maximum(scale * 0.3, norms)
        scale[scale == 0] = 1.0
        upper, qtr = _triangle(jacobian, r, scale)
        gain = 0.0
        while iteration < max_iterations:
            iteration += 1
            step = _damped_step(upper, qtr, damping)
            along = upper @ step
            predicted = float(-2 * (qtr @ along) - along @ along)
            small = predicted <= max(tolerance, 1e-6 * cost if damping < 1e-2 else 1e-9 * cost)
            whole = np.zeros_like(theta)
            whole[free] = step / scale
            trial = theta + whole if moved is None else moved(theta, whole)
            if small and physical and np.all(np.abs(trial - theta) <= LINEAR * np.abs(theta)) and physical(trial):
                theta, r, cost = trial, r + jacobian @ (step / scale), cost - predicted
                status, converged = DONE, True
                break
            now = residual(trial, True)
            if now is None or now[1] is None:
                damping *= growth
                growth *= 2
                continue
            new_cost = float(now[0] @ now[0])
            gain = (cost - new_cost) / predicted if predicted > 0 else -1.0
            if gain > 0 or (small and new_cost <= cost * (1 + 1e-9)):
                theta, r, jacobian, cost = trial, now[0], _moving(now[1], free), new_cost
                damping *= max(1 / 10.0, 1 - (2 * min(gain, 1.0) - 1) ** 3)
                growth = 2.0
                if small:
                    status, converged = DONE, True
                break
            if small or damping > 1e12:
                status, converged = "converged: at the floor of rounding", True
                break
            damping *= growth
            growth *= 2
        if converged:
            break
    return Fit(theta, cost, r, jacobian, free, iteration, converged, status)


def _moving(jacobian: Real, free: NDArray[np.bool_]) -> Real:
    return jacobian if jacobian.shape[1] < len(free) else jacobian[:, free]


def _triangle(matrix: Real, vector: Real, scale: Real) -> tuple[Real, Real]:
    """R and Q^T vector of matrix / scale = Q R.

    By the columns' products where they are clear of one another, which costs a fraction; by reflections where not.
    """
    products = np.asarray((matrix.T @ matrix) / np.outer(scale, scale))
    clear = _factored(products, (vector @ matrix) / scale)
    if clear is not None:
        return clear
    qtr, upper = qr_multiply(matrix / scale, vector, mode="right")
    return np.asarray(upper), np.asarray(qtr)


def _factored(products: Real, along: Real) -> tuple[Real, Real] | None:
    """R and R^-T along, where products = R^T R; None where the columns are not clear of one another."""
    if not len(products):
        return products, along
    upper, failed = dpotrf(products, lower=0, clean=1)
    if failed or upper.diagonal().min() <= CLEAR:
        return None
    return np.asarray(upper), np.asarray(dtrtrs(upper, along, trans=1)[0])


def _damped_step(upper: Real, qtr: Real, damping: float) -> Real:
    """Solution of min |R p + qtr|^2 + damping |p|^2."""
    n = upper.shape[1]
    clear = _factored(upper.T @ upper + damping * np.eye(n), qtr @ upper)
    if clear is None:
        stacked = np.concatenate([upper, np.sqrt(damping) * np.eye(n)])
        along, triangle = qr_multiply(stacked, np.concatenate([qtr, np.zeros(n)]), mode="right")
        return np.asarray(-np.linalg.solve(triangle, along))
    return np.asarray(-dtrtrs(*clear)[0]) if n else clear[1]


def covariance_of(jacobian: Real) -> Real:
    """(J^T J)^-1 by singular values, with scaled columns; a direction that the data do not see gets a huge variance."""
    norms = np.sqrt(np.einsum("nk,nk->k", jacobian, jacobian))
    norms = np.maximum(norms, 1e-100)
    _, singular, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
    singular = np.maximum(singular, 1e-12 * singular[0])
    root = vt.T / singular
    return np.asarray(root @ root.T) / np.outer(norms, norms)
