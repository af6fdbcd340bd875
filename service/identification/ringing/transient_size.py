"""What of the blocks rang, after starts or kept up by noise: how large it was, and what it put into each block.

The settled value of each point is free, so what rings shows in how the blocks change from one to the next. Each source
of it is random with a covariance over the blocks that is known but for its size: what starts make of a pole has a
common size at the points that excite one bearing. The sizes are those of the largest likelihood, and with them the
blocks are a Gaussian process: what each source put into them, and how well that is known, follows (empirical Bayes;
Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, eq. 2.22 to 2.24).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert

from service.identification.arrays import Complex, Real
from service.identification.measured.points import PlanePoints, Unsettled
from service.identification.ringing.pole import Ringing

SIZES = np.concatenate([[0.0], np.geomspace(1e-3, 1e9, 121)])
"""Variances that are tried for what starts leave, in units of what one point's blocks tell of it on their own."""
AMPLITUDES = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 241)])
"""Sizes, in those of a start from rest, that are tried for starts which the blocks hardly show."""
TOGETHER = 6
"""Steps in which the sizes of several sources find to one another."""


@dataclass(frozen=True)
class Source:
    """Something that rings."""

    unit: Complex
    """(P, B, c, B, c) covariance of what one of size 1 puts into the blocks."""
    size: Real
    """(P,)"""
    group: NDArray[np.int64] | None = None
    """(P,) points that share a size, one number each; None where the size is known."""
    spread: Complex | None = None
    """(P, n, n) what one of size 1 puts into how the blocks change, once a `Taken` has it."""

    @property
    def covariance(self) -> Complex:
        """The same of one of this size."""
        return np.asarray(self.size[:, None, None, None, None] * self.unit)

    @classmethod
    def started(cls, left: Complex, size: Real, axis: NDArray[np.int64] | None = None) -> Source:
        """What starts leave, (P, B, c) for one of size 1; without axes of a size that the blocks do not change."""
        return cls(np.asarray(left[:, :, :, None, None] * left[:, None, None].conj()), size, axis)


@dataclass(frozen=True)
class Taken:
    """What several sources put into the blocks, estimated together: its posterior, their sizes given."""

    measured: Complex
    """(P, B, c) residuals."""
    white: Complex
    """(P, c, c) what makes one block's noise white."""
    sources: tuple[Source, ...] = ()

    def with_one_more(self, source: Source) -> Taken:
        """With one more, of a size by itself; the sizes of all are then made to agree with one another."""
        now = replace(self, sources=(*self.sources, replace(source, spread=self._unit_spread(source))))
        for _ in range(TOGETHER if sum(s.group is not None for s in now.sources) > 1 else 0):
            now = replace(now, sources=tuple(map(now._resized, now.sources)))  # expectation and maximisation
        return now

    def started(self, ringing: Ringing, axis: NDArray[np.int64]) -> tuple[float, Real]:
        """Gain of log likelihood when starts of the best common sizes are allowed beside the sources, and these, (P,).

        Tones at either bearing leave transients of different size.
        """
        told, seen = self._told_of(ringing)
        gain, size = 0.0, np.zeros(len(axis))
        for k in np.unique(axis):
            mine = axis == k
            if not np.max(told[mine]) > 0:
                continue
            sizes = SIZES / np.max(told[mine])
            more = 1.0 + sizes[:, None] * told[mine]
            gains = np.sum(sizes[:, None] * seen[mine] / more - np.log(more), axis=1)
            gain += float(gains.max())
            size[mine] = sizes[gains.argmax()]
        return gain, size

    def allowed(self, ringing: Ringing) -> float:
        """Expected square of the size of starts at which the blocks hardly hint, beside the sources.

        Of a size that may as well be nothing as that of a start from rest, equally likely a priori in between. The
        likeliest is often none at all where as much as noise keeps up is left of a start, and deviations that hold
        it for the truth are too small (Gelman, Bayesian Analysis 1, 2006, 515-534).
        """
        told, seen = self._told_of(ringing)
        square = AMPLITUDES[:, None] ** 2
        likelihood = np.sum(square * seen / (1.0 + square * told) - np.log1p(square * told), axis=1)
        weight = np.exp(likelihood - likelihood.max()) * np.gradient(AMPLITUDES)
        return float(weight @ square[:, 0] / weight.sum())

    @cached_property
    def likelihood(self) -> float:
        """Log likelihood of the blocks' changes, but for what no source changes."""
        seen = self._changed(self.measured)
        _, size = np.linalg.slogdet(self._inverse)
        return float(np.sum(size) - np.sum(np.einsum("pn,pn->p", seen.conj(), self._weighed).real))

    def alone(self, source: Source) -> Complex:
        """What one source put into the blocks, (P, B, c)."""
        return np.asarray(self._through(source) @ self._weighed[:, :, None]).reshape(self.measured.shape)

    @cached_property
    def blocks(self) -> Complex:
        """What all of them put into the blocks, (P, B, c)."""
        return np.asarray(sum((self.alone(s) for s in self.sources), np.zeros_like(self.measured)))

    @cached_property
    def unknown(self) -> Unsettled:
        """What is not known of it."""
        points, blocks, channels = self.measured.shape
        through = np.asarray(sum(self._through(s) for s in self.sources))
        prior = np.asarray(sum(self._flat(s) for s in self.sources))
        left = (prior - through @ self._inverse @ _adjoint(through)).reshape(points, blocks, channels, blocks, channels)
        of_mean = left.mean(axis=(1, 3))
        scatter = (np.einsum("pbcbc->pc", left) / blocks - np.einsum("pcc->pc", of_mean)).real * blocks / (blocks - 1)
        # a covariance stays one though it is the small difference of large ones
        size, along = np.linalg.eigh(self.white @ of_mean @ _adjoint(self.white))
        back = np.linalg.inv(self.white) @ along
        return Unsettled((back * np.maximum(size, 0.0)[:, None]) @ _adjoint(back), np.maximum(scatter, 0.0))

    @cached_property
    def _changes(self) -> Complex:
        """What makes of blocks the part that does not hang on their mean, in units of the noise, (P, n, B c)."""
        points, blocks, channels = self.measured.shape
        both = helmert(blocks)[None, :, None, :, None] * self.white[:, None, :, None, :]
        return np.asarray(both.reshape(points, (blocks - 1) * channels, blocks * channels))

    def _changed(self, blocks: Complex) -> Complex:
        """That part of blocks (P, B, c), (P, n)."""
        return np.asarray(self._changes @ blocks.reshape(len(blocks), -1, 1))[:, :, 0]

    def _told_of(self, ringing: Ringing) -> tuple[Real, Real]:
        """What the blocks can tell of starts, and what they show of them: squares, for one of size 1, (P,) each."""
        left = self._changed(ringing.left)
        told = (left[:, None].conj() @ self._inverse @ left[:, :, None])[:, 0, 0].real
        return told, np.abs(np.einsum("pn,pn->p", left.conj(), self._weighed)) ** 2

    def _flat(self, source: Source) -> Complex:
        """Covariance of a source's blocks, (P, B c, B c)."""
        n = self._changes.shape[2]
        return source.covariance.reshape(-1, n, n)

    def _through(self, source: Source) -> Complex:
        """Its covariance with that part, (P, B c, n)."""
        return np.asarray(self._flat(source) @ _adjoint(self._changes))

    def _unit_spread(self, source: Source) -> Complex:
        """Covariance of that part of one of size 1, (P, n, n)."""
        n = self._changes.shape[2]
        return np.asarray(self._changes @ source.unit.reshape(-1, n, n) @ _adjoint(self._changes))

    def _spread(self, source: Source) -> Complex:
        """The same of one of its size."""
        spread = self._unit_spread(source) if source.spread is None else source.spread
        return np.asarray(source.size[:, None, None] * spread)

    @cached_property
    def _inverse(self) -> Complex:
        """Inverse covariance of that part of what was measured, (P, n, n)."""
        total = np.eye(self._changes.shape[1], dtype=np.complex128)[None]
        whole = np.asarray(sum((self._spread(s) for s in self.sources), total))
        return np.asarray(np.broadcast_to(np.linalg.inv(whole), (len(self.measured), *whole.shape[1:])))

    @cached_property
    def _weighed(self) -> Complex:
        """That part of what was measured, through this inverse, (P, n)."""
        return np.asarray(self._inverse @ self._changed(self.measured)[:, :, None])[:, :, 0]

    def _resized(self, source: Source) -> Source:
        if source.group is None:
            return source
        spread = self._spread(source)
        weighed = self._weighed[:, :, None]
        square = (_adjoint(weighed) @ spread @ weighed)[:, 0, 0].real
        expected = np.einsum("pnm,pmn->p", self._inverse, spread).real
        size = source.size.copy()
        for k in np.unique(source.group):
            mine = source.group == k
            size[mine] *= max(0.0, 1.0 + float(np.mean(square[mine] - expected[mine])))
        return replace(source, size=size)


def _adjoint(matrices: Complex) -> Complex:
    return np.asarray(matrices.conj().transpose(0, 2, 1))


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


def evidence_of(ringing: Ringing, along: Along, points: PlanePoints) -> float:
    """`Taken.started` where nothing else rings; quick enough for every length that blocks could have."""
    change = ringing.powers - ringing.powers.mean(axis=1, keepdims=True)
    told = np.sum(np.abs(change) ** 2, axis=1) * np.abs(ringing.mean) ** 2 * along.size
    seen = np.abs(ringing.mean.conj() * np.sum(change.conj() * along.product, axis=1)) ** 2
    gain = 0.0
    for k in np.unique(points.axis):
        mine = points.axis == k
        if np.max(told[mine]) > 0:
            sizes = SIZES[:, None] / np.max(told[mine])
            more = 1.0 + sizes * told[mine]
            gain += float(np.max(np.sum(sizes * seen[mine] / more - np.log(more), axis=1)))
    return gain
