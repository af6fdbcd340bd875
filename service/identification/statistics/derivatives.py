"""Derivatives of what a model says to its free parameters, and the standard deviations that follow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real


def central_differences(of: Callable[[Real], Real], theta: Real, free: NDArray[np.bool_], steps: Real) -> Real:
    """Derivatives of K functions of the parameters to the free ones, (K, n).

    Parameters
    ----------
    of
        (size,) parameters -> (K,) values, which may be complex.
    theta
        (size,)
    free
        (size,) True for n of them.
    steps
        (n,) in units of each: far below its deviation, far above what rounding moves the functions by.

    >>> central_differences(lambda t: t**2, np.array([1.0, 3.0]), np.array([False, True]), np.array([0.1])).round(9)
    array([[0.],
           [6.]])
    """
    columns = []
    for place, size in zip(np.flatnonzero(free), steps, strict=True):
        step = np.zeros_like(theta)
        step[place] = size
        columns.append((of(theta + step) - of(theta - step)) / (2 * size))
    return np.stack(columns, axis=-1)


def propagated_std(gradient: Real, covariance: Real) -> Real:
    """Standard deviations of K functions with these derivatives (K, n), to first order, (K,).

    >>> propagated_std(np.array([[3.0, 4.0]]), np.eye(2))
    array([5.])
    """
    return np.asarray(np.sqrt(np.maximum(np.einsum("kn,nm,km->k", gradient, covariance, gradient), 0.0)))
