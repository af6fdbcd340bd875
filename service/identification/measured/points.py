"""The excited points of one plane, taken from a sweep and checked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.identification.arrays import Complex, Real
from service.identification.plane.many_lines import ManyLines
from service.identification.plane.prediction import Points, Together
from sim.errors import AmbError

UNUSABLE = ("tripped", "excluded", "aborted", "lost")
"""A point whose flag has one of these words is left out of every fit."""
SUSPECT = ("not settled", "unsettled", "is distorted")
"""A point whose flag has one of these counts little: its mean is off by more than its noise."""
FEWEST_LINES = 5
"""Different frequencies of an axis, below which no start of a fit is found, however often each was measured."""
NARROWEST = 1.001
"""Highest over lowest frequency, below which all of them tell the same of a plant: lines of a step are one equation."""


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """Fundamentals of points, block by block: n is 2 for a plane and 4 for a rotor."""

    omega: Real
    """(P,) rad/s."""
    axis: NDArray[np.int64]
    """(P,) the excited one of the n axes."""
    U: Complex
    """(P, B, n) A; so is I, and Y in m."""
    I: Complex | None
    Y: Complex
    suspect: NDArray[np.bool_]
    """(P,) points that count little, by their flag."""

    @cached_property
    def u(self) -> Complex:
        """(P, n) mean over the blocks; so are i and y."""
        return np.asarray(self.U.mean(axis=1))

    @cached_property
    def i(self) -> Complex | None:
        """(P, n) A."""
        return None if self.I is None else np.asarray(self.I.mean(axis=1))

    @cached_property
    def y(self) -> Complex:
        """(P, n) m."""
        return np.asarray(self.Y.mean(axis=1))

    def select(self, keep: NDArray[np.bool_]) -> Self:
        """Some of the points."""
        return replace(
            self,
            omega=self.omega[keep],
            axis=self.axis[keep],
            U=self.U[keep],
            I=None if self.I is None else self.I[keep],
            Y=self.Y[keep],
            suspect=self.suspect[keep],
        )


@dataclass(frozen=True)
class Unsettled:
    """What is not known of what rang in the points, and was taken out of the blocks of i and y, or of y alone."""

    mean: Complex
    """(P, c, c) covariance of the blocks' mean, beside that of the noise."""
    scatter: Real
    """(P, c) variance of a block about the mean."""

    def select(self, keep: NDArray[np.bool_]) -> Unsettled:
        """Of some of the points."""
        return Unsettled(self.mean[keep], self.scatter[keep])


@dataclass(frozen=True, kw_only=True)
class PlanePoints(Blocks):
    """The points that excite one plane; axis is 0 for bearing A, 1 for B."""

    plane: str
    axes: tuple[str, str]
    R: Complex
    """(P, B, 2) A."""
    index: NDArray[np.int64]
    """(P,) place in the sweep."""
    left_out: tuple[str, ...]
    """Why points were not used, one line each."""
    many: ManyLines | None = None
    """Of a multisine on all axes whose phases are known: its points excite the rotor at the same time."""
    together: Together | None = None
    """Of a multisine whose phases are not."""
    unsettled: Unsettled | None = None
    """Where something rang."""

    @property
    def n_blocks(self) -> int:
        """B."""
        return int(self.U.shape[1])

    @cached_property
    def r(self) -> Complex:
        """(P, 2) A, mean over the blocks."""
        return np.asarray(self.R.mean(axis=1))

    @cached_property
    def at(self) -> Points:
        """Where a model is evaluated for the means."""
        return Points(self.omega, self.u)

    @cached_property
    def i_rows(self) -> Complex | None:
        """(2, P) i, the points along memory; so is y."""
        return None if self.i is None else np.ascontiguousarray(self.i.T)

    @cached_property
    def y_rows(self) -> Complex:
        """(2, P) m."""
        return np.ascontiguousarray(self.y.T)

    def select(self, keep: NDArray[np.bool_]) -> Self:
        """Some of the points."""
        return replace(
            super().select(keep),
            R=self.R[keep],
            index=self.index[keep],
            many=None if self.many is None else self.many.select(keep),
            together=None if self.together is None else replace(self.together, group=self.together.group[keep]),
            unsettled=None if self.unsettled is None else self.unsettled.select(keep),
        )


def planes_of(axes: tuple[str, ...]) -> dict[str, tuple[int, int]]:
    """Planes and the places of their two axes.

    >>> planes_of(("xA", "xB", "yA", "yB"))
    {'x': (0, 1), 'y': (2, 3)}
    """
    return {axes[k][0]: (k, k + 1) for k in range(0, len(axes) - 1, 2)}


def plane_points(sweep: Sweep, axes: tuple[str, ...], plane: str) -> PlanePoints:
    """Usable points of a sweep that excite one plane.

    Points with amplitude 0, not-a-number, no displacement at all or a flag in `UNUSABLE` are left out and listed.

    Raises
    ------
    AmbError
        No harmonic 1, or fewer than two blocks: without them there is no noise estimate.
    """
    if 1 not in sweep.harmonics:
        raise AmbError(f"sweep {sweep.comment!r} has harmonics {sweep.harmonics} only; the excited line, 1, is needed")
    if sweep.U.shape[1] < 2:
        raise AmbError(
            f"sweep {sweep.comment!r} has {sweep.U.shape[1]} block per point; at least 2 blocks of whole periods are "
            "needed to tell signal from noise"
        )
    pair = planes_of(axes)[plane]
    h = sweep.harmonic(1)
    where = (slice(None), slice(None), h, list(pair))
    members = np.isin(sweep.axis, pair) & (sweep.frequency_hz > 0)
    signals = [sweep.R[where], sweep.U[where], sweep.Y[where]] + ([] if sweep.I is None else [sweep.I[where]])
    finite = np.all([np.isfinite(x).all(axis=(1, 2)) for x in signals], axis=0)
    driven = (sweep.amplitude_a > 0) & (np.abs(np.nan_to_num(signals[1])).max(axis=(1, 2)) > 0)
    heard = np.abs(np.nan_to_num(signals[2])).max(axis=(1, 2)) > 0
    flags = sweep.flags or ("",) * sweep.n_points
    sound = np.array([not any(word in f.lower() for word in UNUSABLE) for f in flags], dtype=bool)
    left_out = []
    usable = finite & driven & heard & sound
    for p in np.flatnonzero(members & ~usable):
        why = _why_not(bool(finite[p]), bool(driven[p]), bool(heard[p])) or flags[p]
        left_out.append(f"{axes[sweep.axis[p]]} at {sweep.frequency_hz[p]:.4g} Hz: {why}")
    keep = np.flatnonzero(members & usable)
    keep = keep[np.lexsort((sweep.axis[keep], sweep.frequency_hz[keep]))]
    r, u, y = (np.ascontiguousarray(x[keep], dtype=complex) for x in signals[:3])
    i = np.ascontiguousarray(signals[3][keep], dtype=complex) if len(signals) == 4 else None
    return PlanePoints(
        plane=plane,
        axes=(axes[pair[0]], axes[pair[1]]),
        omega=2 * np.pi * sweep.frequency_hz[keep].astype(float),
        axis=(sweep.axis[keep] - pair[0]).astype(np.int64),
        R=r,
        U=u,
        I=i,
        Y=y,
        index=keep,
        left_out=tuple(left_out),
        suspect=np.array([any(word in flags[p].lower() for word in SUSPECT) for p in keep], dtype=bool),
        many=ManyLines.of(sweep, keep),
        together=_together(sweep, keep, pair),
    )


def _why_not(finite: bool, driven: bool, heard: bool) -> str:
    if not finite:
        return "not finite"
    if not driven:
        return "amplitude 0"
    return "" if heard else "y reads 0 in every block, below the resolution of the log or of a sensor without a signal"


def _together(sweep: Sweep, keep: NDArray[np.int64], pair: tuple[int, int]) -> Together | None:
    """All points of a multisine on all axes at once, or those of each axis where the file tells no kurtosis."""
    if sweep.kind != "multisine":
        return None
    if sweep.kurtosis is None:
        return Together(np.asarray(sweep.axis[keep], dtype=np.int64), np.ones(2))
    return Together(np.zeros(len(keep), dtype=np.int64), np.asarray(sweep.kurtosis[list(pair)], dtype=float))


def check_excitation(points: PlanePoints, minimum: int = 8) -> None:
    """Refuse a plane that cannot be told apart.

    Raises
    ------
    AmbError
        Only one axis excited, too few points, or all of them at a few frequencies.
    """
    counts = np.bincount(points.axis, minlength=2)
    for axis in range(2):
        if counts[axis] == 0 and counts[1 - axis]:
            raise AmbError(
                f"plane {points.plane}: only {points.axes[1 - axis]} is excited; a 2 x 2 plant needs points that "
                f"excite {points.axes[axis]} as well"
            )
    if counts.min() < minimum:
        why = f" ({points.left_out[0]}, ...)" if points.left_out else ""
        raise AmbError(
            f"plane {points.plane}: {counts[0]} and {counts[1]} usable points excite {points.axes[0]} and "
            f"{points.axes[1]}; at least {minimum} each are needed{why}"
        )
    lines = [len(same_frequency(points.omega[points.axis == axis])) for axis in range(2)]
    if min(lines) < FEWEST_LINES:
        raise AmbError(
            f"plane {points.plane}: {points.axes[0]} and {points.axes[1]} are excited at {lines[0]} and {lines[1]} "
            f"different frequencies; at least {FEWEST_LINES} each are needed, as many points as there may be of each"
        )
    lowest, highest = float(points.omega.min()), float(points.omega.max())
    if highest < NARROWEST * lowest:
        raise AmbError(
            f"plane {points.plane}: all points lie between {lowest / (2 * np.pi):.9g} and "
            f"{highest / (2 * np.pi):.9g} Hz, which is one place of the response: measure over the band of the loop"
        )


def same_frequency(omega: Real, relative: float = 1e-6) -> list[NDArray[np.int64]]:
    """Places of points that share a frequency, ascending.

    >>> [g.tolist() for g in same_frequency(np.array([1.0, 2.0, 1.0]))]
    [[0, 2], [1]]
    """
    order = np.argsort(omega, kind="stable")
    if not len(order):
        return []
    breaks = np.flatnonzero(np.diff(omega[order]) > relative * omega[order][:-1]) + 1
    return [np.sort(g) for g in np.split(order, breaks)]
