"""Linear estimates of a point's response from its blocks, with the deviations that they leave."""

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
    """(P, B) weight of each block in the response"""
    residual_map: Complex
    """(P, B, B) blocks -> deviations from the estimate, scaled so that their sum of squares over B - 1 is a block's
    variance"""
    dof: Real
    """(P,) complex degrees of freedom of the deviations"""

    def select(self, points: NDArray[np.int64]) -> Estimate:
        """The estimate of some of the points."""
        return Estimate(self.weights[points], self.residual_map[points], self.dof[points])

    @property
    def spread(self) -> Real:
        """Variance of the response over that of a mean over as many independent blocks, (P,)."""
        return np.asarray(self.weights.shape[1] * (np.abs(self.weights) ** 2).sum(axis=1))


def plain_mean(points: int, blocks: int) -> Estimate:
    """The mean over a point's blocks."""
    weights, residual_map = np.full(blocks, 1 / blocks, dtype=complex), np.eye(blocks) - 1 / blocks + 0j
    return Estimate(
        np.broadcast_to(weights, (points, blocks)),
        np.broadcast_to(residual_map, (points, blocks, blocks)),
        np.full(points, blocks - 1.0),
    )
