"""How large transients are: by themselves, with the evidence that there is one, and several together.

The settled value of each point is free, so a transient shows in how the blocks change from one to the next. Its sizes
at the points have a common variance, estimated by maximum likelihood, and each is drawn towards zero by as much as its
own uncertainty asks for (empirical Bayes).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.identification.points import PlanePoints
from service.identification.ringing import Ringing
from service.identification.zoh import Complex, Real

SIZES = 121
"""Of the grid on which the size of a transient is looked for."""
TOGETHER = 6
"""Steps in which the sizes of several transients find to one another."""


@dataclass(frozen=True)
class Along:
    """The blocks' residuals along the trace of a pole, which does not hang on the length of the blocks."""

    product: Complex
    """(P, B) in units of the noise."""
    size: Real
    """(P,) of the trace, squared."""

    @classmethod
    def of(cls, trace: Complex, e: Complex, white: Complex) -> Along:
        """For residuals (P, B, c) and their whitening (P, c, c)."""
        unit = np.einsum("pcd,pd->pc", white, trace)
        product = np.einsum("pd,pbd->pb", np.einsum("pc,pcd->pd", unit.conj(), white), e)
        return cls(np.asarray(product), np.sum(np.abs(unit) ** 2, axis=1))


@dataclass(frozen=True)
class Taken:
    """Transients of several poles, estimated together: each point's posterior, their common sizes given."""

    measured: Complex
    """(P, B, c) residuals."""
    white: Complex
    """(P, c, c)"""
    ringings: tuple[Ringing, ...] = ()
    sizes: Real = field(default_factory=lambda: np.empty((0, 0)))
    """(K, P) variances of alpha."""

    def and_one(self, ringing: Ringing, size: Real, axis: NDArray[np.int64]) -> Taken:
        """With one pole more, of a size by itself; those of all are then made to agree with one another."""
        sizes = np.concatenate([self.sizes.reshape(-1, len(size)), size[None]])
        now = Taken(self.measured, self.white, (*self.ringings, ringing), sizes)
        for _ in range(TOGETHER if len(sizes) > 1 else 0):  # expectation and maximisation
            alpha, covariance = now.posterior
            second = np.abs(alpha) ** 2 + np.einsum("pkk->pk", covariance).real
            sizes = np.zeros_like(sizes)
            for k in np.unique(axis):
                sizes[:, axis == k] = second[axis == k].mean(axis=0)[:, None]
            now = replace(now, sizes=np.where(now.sizes > 0, sizes, 0.0))
        return now

    @cached_property
    def posterior(self) -> tuple[Complex, Complex]:
        """Mean (P, K) and covariance (P, K, K) of the alphas, the settled values free."""
        change = np.stack([r.powers - r.powers.mean(axis=1, keepdims=True) for r in self.ringings], axis=1)
        unit = np.stack([np.einsum("pcd,pd->pc", self.white, r.trace) for r in self.ringings], axis=1)
        normal = np.einsum("pkb,plb->pkl", change.conj(), change) * np.einsum("pkc,plc->pkl", unit.conj(), unit)
        seen = np.einsum("pcd,pbd->pbc", self.white, self.measured)
        right = np.einsum("pkb,pkb->pk", change.conj(), np.einsum("pkc,pbc->pkb", unit.conj(), seen))
        root = np.sqrt(self.sizes.T)
        inner = root[:, :, None] * normal * root[:, None, :] + np.eye(len(self.ringings))
        covariance = root[:, :, None] * np.linalg.inv(inner) * root[:, None, :]
        return np.asarray(np.einsum("pkl,pl->pk", covariance, right)), np.asarray(covariance)

    def alone(self, k: int) -> Complex:
        """What one pole put into the blocks, (P, B, c)."""
        ringing, alpha = self.ringings[k], self.posterior[0][:, k]
        return np.asarray(alpha[:, None, None] * ringing.powers[:, :, None] * ringing.trace[:, None, :])

    @cached_property
    def blocks(self) -> Complex:
        """What all of them put into the blocks, (P, B, c)."""
        return np.asarray(sum((self.alone(k) for k in range(len(self.ringings))), np.zeros_like(self.measured)))

    @property
    def left(self) -> Complex:
        """Residuals without it, (P, B, c)."""
        return np.asarray(self.measured - self.blocks)

    @property
    def unknown(self) -> Complex:
        """Covariance of what is not known of it in the blocks' mean, (P, c, c)."""
        mean = np.stack([r.powers.mean(axis=1)[:, None] * r.trace for r in self.ringings], axis=1)
        return np.asarray(np.einsum("pkl,pkc,pld->pcd", self.posterior[1], mean, mean.conj()))


def estimates(ringing: Ringing, along: Along) -> tuple[Complex, Real]:
    """alpha of each point by least squares over the blocks, the settled value free, and its variance, (P,) each."""
    change = ringing.powers - ringing.powers.mean(axis=1, keepdims=True)
    weight = np.sum(np.abs(change) ** 2, axis=1) * np.abs(ringing.mean) ** 2 * along.size
    product = ringing.mean.conj() * np.sum(change.conj() * along.product, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(product / weight), np.asarray(1.0 / weight)


def evidence_of(ringing: Ringing, along: Along, points: PlanePoints) -> tuple[float, Real]:
    """Gain of log likelihood when a transient of the best common size is allowed, and that variance, (P,).

    Tones at either bearing leave transients of different size.
    """
    alpha, variance = estimates(ringing, along)
    total, size = 0.0, np.zeros(len(alpha))
    for axis in (0, 1):
        mine = (points.axis == axis) & np.isfinite(variance)
        if not mine.any():
            continue
        square, v = np.abs(alpha[mine]) ** 2, variance[mine]
        grid = np.geomspace(1e-3 * v.min(), 10 * square.max() + 1e-3 * v.min(), SIZES)
        sum_ = grid[:, None] + v
        gain = np.sum(np.log(v / sum_) + square * (1 / v - 1 / sum_), axis=1)
        best = int(np.argmax(gain))
        if gain[best] > 0:
            total += float(gain[best])
            size[points.axis == axis] = grid[best]
    return total, size
