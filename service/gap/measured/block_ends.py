"""Variance of a mean over consecutive blocks whose end effects cancel.

Y = G U holds for a block except for a term of the states at its two ends (transient leakage). It is all that a
controller leaves, whose law holds sample by sample; of a plant it matters at low frequencies, where noise moves its
slow states. A block begins where the one before ended, so these terms telescope: the mean over B blocks holds only the
first and the last, and its variance is that of one block over B squared, not over B. Sensor noise does not cancel, nor
do blocks that are not consecutive. The share of each is estimated from the correlation of neighbouring blocks.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from service.gap.measured.estimate import Estimate, plain_mean

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ENOUGH_BLOCKS = 4
"""Fewest blocks for an estimate of the correlation of neighbours."""
CHANCE_DEVIATIONS = 2.0
"""Standard deviations of the estimate by which the ratio must be below one for a cancellation to be believed."""
NEIGHBOURS = 12
"""Points on either side, by frequency, over which correlations are pooled: one point has too few blocks."""


def mean_variance_ratio(deviations: Complex, variance: Real, frequency_hz: Real, by: Estimate | None = None) -> Real:
    """Variance of a point's mean over that of the mean of independent blocks, (P,): 1 / B where all cancels, 1 else.

    Only neighbouring blocks are taken to be correlated.

    Parameters
    ----------
    deviations
        Of blocks from their mean, or from another estimate ``by``, (P, B, n).
    variance
        Of a block, (P, n), pooled over neighbouring points: that of a point's own blocks is correlated with the ratio.
    frequency_hz
        Of each point, (P,): the share of the end effects varies with frequency.
    """
    blocks = deviations.shape[1]
    if blocks < ENOUGH_BLOCKS:
        return np.ones(len(deviations))
    by = by or plain_mean(len(deviations), blocks)
    enough = by.dof > ENOUGH_BLOCKS - 1.5  # a hum that is taken off leaves fewer than a mean does, of four blocks one
    e = deviations / np.sqrt(np.maximum(variance, 1e-300))[:, None]
    order = np.argsort(frequency_hz, kind="stable")
    # Sums of products of deviations at lags 0 and 1 that a unit variance of blocks makes, and a unit covariance of
    # neighbours; solving for both from the sums seen is unbiased, although the deviations have lost the mean.
    neighbour_covariance = np.eye(blocks, k=1) + np.eye(blocks, k=-1)
    of_deviations = [
        by.residual_map @ covariance @ by.residual_map.conj().swapaxes(1, 2)
        for covariance in (np.eye(blocks), neighbour_covariance)
    ]
    expected = np.array([[np.trace(m, lag, 1, 2).real for m in of_deviations] for lag in (0, 1)])  # (2, 2, P)
    seen = np.array([_lagged_sum(e, lag) for lag in (0, 1)])[:, None]  # (2, 1, P)
    sums = np.concatenate([expected, seen], axis=1)[..., order]
    pooled = np.empty_like(sums)
    # a running mean; ``scipy.ndimage``, which has one, takes longer to load than a whole experiment to be read
    mirrored = np.pad(sums, [(0, 0), (0, 0), (NEIGHBOURS, NEIGHBOURS)], mode="symmetric")
    pooled[..., order] = sliding_window_view(mirrored, 2 * NEIGHBOURS + 1, axis=-1).mean(axis=-1)
    systems = np.moveaxis(pooled, -1, 0)  # (P, 2, 3)
    systems[~enough, :, :2] = np.eye(2)  # not singular; what they give is not used
    block_variance, covariance = np.linalg.solve(systems[..., :2], systems[..., 2:])[..., 0].T
    w = by.weights
    neighbour_weight = (w[:, 1:].conj() * w[:, :-1]).real.sum(axis=1) / (np.abs(w) ** 2).sum(axis=1)
    ratio = 1 + 2 * neighbour_weight * covariance / np.where(block_variance > 0, block_variance, np.inf)
    # Only what is clearly below one counts: clipped at one alone, an estimate that scatters would be biased low.
    pairs = min(2 * NEIGHBOURS + 1, len(e)) * e.shape[2] * (blocks - 1)
    deviation = 2 * np.abs(neighbour_weight) / np.sqrt(2 * pairs)
    cancels = enough & (ratio < 1 - CHANCE_DEVIATIONS * deviation)
    return np.asarray(np.where(cancels, np.maximum(ratio, 1 / blocks), 1.0))


def _lagged_sum(e: Complex, lag: int) -> Real:
    """Sum over blocks and channels of e_b conj(e_(b + lag)), real part, (P,)."""
    return np.asarray(np.sum((e[:, : e.shape[1] - lag] * e[:, lag:].conj()).real, axis=(1, 2)))
