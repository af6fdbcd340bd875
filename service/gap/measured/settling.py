"""Whether the rig had settled: an F test of a linear trend along the blocks of a point.

A transient that still decays makes a trend from block to block; noise has none. The trend is compared with the scatter
about it, as the scatter about the mean holds the transient itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.distributions import f_tail
from service.experiment.data import Sweep

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

FALSE_DRIFT_PROBABILITY = 0.01
"""Probability that a settled point counts as drifting."""
ENOUGH_BLOCKS = 3
"""Fewest blocks from which the scatter about a trend can be estimated."""
NOTED_DRIFTING_SHARE = 0.3
"""Share of drifting points from which a note says so. On 72 campaigns of three programs that let their rigs settle it
was at most 0.15: `FALSE_DRIFT_PROBABILITY`, and points near sharp modes."""
HALF_A_TURN = 2.5
"""Largest change along a trend that a hum of unit amplitude makes: two while it turns by half, with a margin for the
error of its amplitude."""
UNSETTLED = 0.5
"""Share of drifting points from which no effect is named: where most points are wrong no fit holds, however robust
(breakdown point)."""


def about_trend(X: Complex) -> tuple[Complex, Complex, Real]:
    """Linear regression along the blocks (P, B, n): residuals (P, B, n), slopes (P, n), and the unit regressor (B,)."""
    along = np.linspace(-1.0, 1.0, X.shape[1])
    along /= np.linalg.norm(along)
    slope = np.einsum("b,pbn->pn", along, X)
    return X - X.mean(axis=1, keepdims=True) - along[:, None] * slope[:, None], slope, along


def trend(X: Complex) -> tuple[Real, Real]:
    """p-value of the trend of each point's blocks, (P, n), and the size of the change along it, (P, n).

    Parameters
    ----------
    X
        One harmonic, (P, B, n). With fewer than `ENOUGH_BLOCKS` blocks the p-value is one.
    """
    blocks = X.shape[1]
    if blocks < ENOUGH_BLOCKS:
        nothing = np.zeros((X.shape[0], X.shape[2]))
        return nothing + 1.0, nothing
    about, slope, along = about_trend(X)
    scatter = np.sum(np.abs(about) ** 2, axis=1) / (blocks - 2)
    # Records without noise, or a coarse converter's, may not scatter at all: rounding is no trend.
    least = (np.finfo(float).eps * np.abs(X).max(axis=(1, 2))[:, None]) ** 2
    ratio = np.abs(slope) ** 2 / np.maximum(scatter, np.maximum(least, np.finfo(float).tiny))
    return np.asarray(f_tail(ratio, 2, 2 * (blocks - 2))), np.abs(slope) * (along[-1] - along[0])


def drifting(sweep: Sweep, leaks: tuple[Real, Real] | None = None) -> tuple[NDArray[np.bool_], Real]:
    """Which points had not settled, (P,), and the change of each from first block to last relative to its size, (P,).

    Judged by u and y of the excited axis at the excited frequency. Blocks that are not consecutive have no trend.
    ``leaks`` are the amplitudes in u and y, (P, H, n), of hums that turn too slowly to be distinguished from a trend: a
    change that they could make does not count.
    """
    f, points = sweep.harmonics.index(1), np.arange(sweep.n_points)
    found, change = np.zeros(sweep.n_points, dtype=bool), np.zeros(sweep.n_points)
    if not sweep.in_sequence:
        return found, change
    of_hums = leaks or (np.zeros(sweep.U[:, 0].shape), np.zeros(sweep.Y[:, 0].shape))
    for X, leak in zip((sweep.U[:, :, f], sweep.Y[:, :, f]), of_hums, strict=True):
        probability, moved = (v[points, sweep.axis] for v in trend(X))
        size = np.abs(X.mean(axis=1))[points, sweep.axis]
        beyond_hums = moved > HALF_A_TURN * leak[points, f, sweep.axis]
        found |= (probability < FALSE_DRIFT_PROBABILITY / 2) & beyond_hums
        change = np.maximum(change, moved / np.maximum(size, np.finfo(float).tiny))
    return found, change
