"""Blocks that begin where the one before ended: what their ends leave cancels in the mean.

The controller's law holds sample by sample, so its residual in a block is only what its states at the block's end and
beginning leave; of a plant the slow states leave most at low frequencies, where a stiff loop lets noise move them. From
one block to the next these cancel: the mean over B blocks holds the first and the last only, and its variance is that
of a block over B squared, not over B. Noise of a sensor or of the log does not, nor do blocks that do not follow one
another; so it is read from how neighbouring blocks go together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from service.gap.measured.estimate import Estimate, plain_mean

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ENOUGH_BLOCKS = 4
"""Blocks from which neighbours can be told from others."""
CHANCE_DEVIATIONS = 2.0
"""Standard deviations of what independent blocks show by chance, below which ends are taken to cancel."""
NEIGHBOURS = 12
"""Points on either side, by frequency, whose blocks are looked at together: a point alone has too few."""


def share(deviations: Complex, variance: Real, frequency_hz: Real, by: Estimate | None = None) -> Real:
    """Variance of the mean over that of as many independent blocks, between what cancelling ends leave and 1, (P,).

    Parameters
    ----------
    deviations
        Of blocks from their mean, (P, B, n), or what else ``by`` leaves of them; neighbours alone go together.
    variance
        Of each, (P, n), from its neighbours too: from a point's own blocks alone it goes with what is asked.
    frequency_hz
        Of each point, (P,): how much of the scatter ends leave is a matter of frequency.
    """
    blocks = deviations.shape[1]
    if blocks < ENOUGH_BLOCKS:
        return np.ones(len(deviations))
    by = by or plain_mean(len(deviations), blocks)
    e = deviations / np.sqrt(np.maximum(variance, 1e-300))[:, None]
    order = np.argsort(frequency_hz, kind="stable")
    # what the estimate leaves of a variance of one, and of a covariance of neighbours of one
    beside = np.eye(blocks, k=1) + np.eye(blocks, k=-1)
    made = [by.left @ covariance @ by.left.conj().swapaxes(1, 2) for covariance in (np.eye(blocks), beside)]
    expected = np.array([[np.trace(m, lag, 1, 2).real for m in made] for lag in (0, 1)])  # (2, 2, P)
    pooled = np.concatenate([expected, np.array([_lagged(e, lag) for lag in (0, 1)])[:, None]], axis=1)[..., order]
    smooth = np.empty_like(pooled)
    smooth[..., order] = uniform_filter1d(pooled, 2 * NEIGHBOURS + 1, axis=-1)
    seen = np.moveaxis(smooth, -1, 0)  # (P, 2, 3)
    alone, together = np.linalg.solve(seen[..., :2], seen[..., 2:])[..., 0].T
    w = by.weights
    neighbours = (w[:, 1:].conj() * w[:, :-1]).real.sum(axis=1) / (np.abs(w) ** 2).sum(axis=1)
    of_mean = 1 + 2 * neighbours * together / np.where(alone > 0, alone, np.inf)
    # cut off at one, an estimate that scatters would be below one in the mean of blocks that go together nowhere
    pairs = min(2 * NEIGHBOURS + 1, len(e)) * e.shape[2] * (blocks - 1)
    scatter = 2 * np.abs(neighbours) / np.sqrt(2 * pairs)
    return np.asarray(np.where(of_mean < 1 - CHANCE_DEVIATIONS * scatter, np.maximum(of_mean, 1 / blocks), 1.0))


def _lagged(e: Complex, lag: int) -> Real:
    return np.asarray(np.sum((e[:, : e.shape[1] - lag] * e[:, lag:].conj()).real, axis=(1, 2)))
