"""How large the correlations of white complex residuals with their neighbours are together, exactly to three moments.

The sum of squared correlations over many lags is far from the chi-square of long records: where lags are a tenth of the
residuals its tail is several times as heavy, and a test at a level of one in a thousand rejects five times as often.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_tail
from service.identification.arrays import Complex, Real


def portmanteau(residual: Complex, lags: NDArray[np.int64]) -> tuple[Complex, float, float]:
    """Correlation at each lag, their weighted sum of squares, and how likely white residuals have a larger one.

    The sum is 2 n (n + 1) sum |rho_k|^2 / (n - k), that of Ljung and Box (Biometrika 65, 1978) for complex residuals:
    it has exactly twice the number of lags as its mean. Its tail is that of a shifted and scaled chi-square of the same
    mean, variance and skewness.

    Parameters
    ----------
    residual
        (n,), each of the same variance under whiteness.
    lags
        (L,) integers from 1, below n.
    """
    n = len(residual)
    power = float(np.sum(np.abs(residual) ** 2)) or 1.0
    rho = np.array([np.sum(residual[:-k].conj() * residual[k:]) / power for k in lags], dtype=np.complex128)
    total = float(2 * n * (n + 1) * np.sum(np.abs(rho) ** 2 / (n - lags)))
    if not len(lags):
        return rho, total, 1.0
    mean, std, skewness = _white(n, len(lags))
    freedom = 8.0 / skewness**2
    return rho, total, float(chi2_tail(max(freedom + (total - mean) / std * math.sqrt(2 * freedom), 0.0), freedom))


@lru_cache(maxsize=64)
def _white(n: int, lags: int) -> tuple[float, float, float]:
    """Mean, standard deviation and skewness of the sum for n Gaussian residuals at lags 1, 2, ... ``lags``."""
    first, second, third = (_moment(n, lags, order) for order in (1, 2, 3))
    variance = second - first**2
    return first, math.sqrt(variance), (third - 3 * first * variance - first**3) / variance**1.5


def _moment(n: int, lags: int, order: int) -> float:
    """E[sum^order].

    A product of forms e^H M e of circular Gaussian e has as its mean the sum, over all permutations, of the products of
    traces along their cycles (Isserlis' theorem). M shifts by a lag and back, so its own trace is 0, and that of a
    product is the number of places from which no shift leaves the residuals. The length of e is independent of its
    direction.
    """
    every = np.array(list(product(range(1, lags + 1), repeat=order)), dtype=float).T
    shifts = np.stack([every, -every], axis=1).reshape(2 * order, -1)
    total = np.zeros(every.shape[1])
    for permutation in permutations(range(2 * order)):
        if all(a != b for a, b in enumerate(permutation)):
            total += np.prod([_trace(n, shifts[list(cycle)]) for cycle in _cycles(permutation)], axis=0)
    of_length = math.prod(range(n, n + 2 * order))
    return float(np.sum(total * np.prod(2 * n * (n + 1) / (n - every), axis=0)) / of_length)


def _trace(n: int, shifts: Real) -> Real:
    """Of the product of shifts (m, ...) of n places."""
    at = np.cumsum(shifts, axis=0)
    reach = np.maximum(at.max(axis=0), 0.0) - np.minimum(at.min(axis=0), 0.0)
    return np.where(at[-1] == 0, np.maximum(n - reach, 0.0), 0.0)


def _cycles(permutation: tuple[int, ...]) -> Iterator[list[int]]:
    left = set(range(len(permutation)))
    while left:
        cycle = [min(left)]
        while permutation[cycle[-1]] != cycle[0]:
            cycle.append(permutation[cycle[-1]])
        left -= set(cycle)
        yield cycle
