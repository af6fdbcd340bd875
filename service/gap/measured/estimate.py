"""How a point's response is estimated from its blocks, and what that leaves of them as scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Estimate:
    """A linear estimate of each of P points' responses from B blocks."""

    weights: Complex
    """(P, B) of the blocks in the response"""
    left: Complex
    """(P, B, B) blocks -> their deviations, scaled so that the mean square over B - 1 is a block's variance"""
    free: Real
    """(P,) complex dimensions that the deviations have"""

    def select(self, points: NDArray[np.int64]) -> Estimate:
        """Of some points alone."""
        return Estimate(self.weights[points], self.left[points], self.free[points])

    @property
    def spread(self) -> Real:
        """Variance of the response over that of a mean over as many independent blocks, (P,)."""
        return np.asarray(self.weights.shape[1] * (np.abs(self.weights) ** 2).sum(axis=1))


def plain_mean(points: int, blocks: int) -> Estimate:
    """The mean over a point's blocks, which leaves their deviations from it."""
    weights, left = np.full(blocks, 1 / blocks, dtype=complex), np.eye(blocks) - 1 / blocks + 0j
    return Estimate(
        np.broadcast_to(weights, (points, blocks)),
        np.broadcast_to(left, (points, blocks, blocks)),
        np.full(points, blocks - 1.0),
    )
