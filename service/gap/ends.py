"""Blocks that begin where the one before ended: what their ends leave cancels in the mean.

The controller's law holds sample by sample, so its residual in a block is only what its states at the block's end and
beginning leave. From one block to the next these cancel: the mean over B blocks holds the first and the last only, and
its variance is that of a block over B squared, not over B. Where the log adds noise of its own, or blocks do not follow
one another, they do not; so it is read from how neighbouring blocks go together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

ENOUGH_BLOCKS = 4
"""Blocks from which neighbours can be told from others."""


def share(deviations: Complex, variance: Real) -> float:
    """Variance of the mean over that of as many independent blocks, between what cancelling ends leave and 1.

    Parameters
    ----------
    deviations
        Of blocks from their mean, (P, B, n); neighbours alone go together.
    variance
        Of each, (P, n), from its neighbours too: from a point's own blocks alone it goes with what is asked.
    """
    blocks = deviations.shape[1]
    if blocks < ENOUGH_BLOCKS:
        return 1.0
    e = deviations / np.sqrt(np.maximum(variance, 1e-300))[:, None]
    seen = np.array([_lagged(e, 0), _lagged(e, 1)])
    # what removing the mean makes of a variance of one, and of a covariance of neighbours of one
    less = np.eye(blocks) - 1 / blocks
    beside = np.eye(blocks, k=1) + np.eye(blocks, k=-1)
    made = [less @ covariance @ less for covariance in (np.eye(blocks), beside)]
    alone, together = np.linalg.solve([[np.trace(m) for m in made], [np.trace(m, 1) for m in made]], seen)
    if alone <= 0:
        return 1.0
    return float(np.clip(1 + 2 * (1 - 1 / blocks) * together / alone, 1 / blocks, 1.0))


def _lagged(e: Complex, lag: int) -> float:
    return float(np.sum((e[:, : e.shape[1] - lag] * e[:, lag:].conj()).real))
