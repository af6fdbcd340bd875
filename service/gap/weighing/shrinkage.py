"""Closure: how far the gap shrinks on unseen data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.predict import measured, residual, weights
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import (
    SIGNIFICANT,
    fastest_alone_hz,
    furthest_alone_hz,
    overall,
    shows_alone_hz,
    significance,
)
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PATHS = ("controller", "amplifier", "plant")
SIGNALS = ("u", "i", "y")

J_OF_NOISE = 1.0
"""J of a right twin: residuals in units of their own standard deviation."""
J_OF_EXACT = 0.01
"""J of a path, before and after, below which its law holds exactly, without noise: it is left out of the mean."""
RESAMPLES = 400
"""Bootstrap resamples of a closure's interval."""


@dataclass(frozen=True)
class Closed:
    """J = mean |residual|^2 / variance on the unseen sweep, before and after the effect is added, and the closure."""

    before: float
    after: float
    closure: float | None
    """None where the unseen sweep does not show the gap"""
    closure_95: tuple[float | None, float | None]
    """ends of the 95 % interval; None where it is open"""


@dataclass(frozen=True)
class Shrinkage(Closed):
    """Closure of the whole gap, and of every path and channel."""

    held_out: str
    noise_floor: float
    paths: dict[str, Closed] = field(default_factory=dict)
    """of u, i and y: "controller", "amplifier", "plant" """
    channels: dict[tuple[str, int, int], Closed] = field(default_factory=dict)
    """by signal, its axis and the excited axis"""


def closure_of(before: float, after: float, noise: float = J_OF_NOISE) -> float | None:
    """1 - (J_after - J_noise) / (J_before - J_noise), at most 1; None where J_before shows no gap.

    >>> closure_of(11.0, 2.0)
    0.9
    >>> closure_of(0.9, 0.8) is None
    True
    """
    if before <= noise:
        return None
    return float(min(1.0, 1.0 - (after - noise) / (before - noise)))


def shrinkage(before: Rig, after: Rig, o: Observation, name: str, seed: int = 0) -> Shrinkage:
    """Closure from the twin ``before`` to the twin ``after`` on an unseen sweep ``o`` of that name.

    The 95 % interval is a bootstrap over lines, as the residuals of one line's points are correlated.
    """
    return Unseen(before, o, name, seed).shrinkage(after)


@dataclass(frozen=True)
class _Cell:
    """Some points and channels of an unseen sweep, as the twin before leaves them."""

    points: NDArray[np.bool_]
    """(P,) which points"""
    columns: slice
    """of the channels of [u, i, y]"""
    before: Real
    """|residual|^2 / variance of each of these points"""
    shown: bool
    """whether the gap is significant in them"""


class Unseen:
    """An unseen sweep and a twin whose gap it shows, for the closure by several others (`shrinkage`)."""

    def __init__(self, before: Rig, o: Observation, name: str, seed: int = 0) -> None:
        """``before`` is the twin that has the gap, ``name`` the sweep's; ``seed`` is that of the bootstrap."""
        self._o, self._name = o, name
        self._z, self._known = residual(before, o), weights(o) > 0
        self._drawn = _drawn(len(o.frequency_hz), seed)
        self._signals = [k for k in range(3) if k != 1 or o.I is not None]
        n, everywhere = before.n_axes, np.ones(len(o.axis), dtype=bool)
        of_i, of_y = slice(n, 2 * n), slice(2 * n, 3 * n)
        tests = [(of_i, shows_alone_hz), (of_y, furthest_alone_hz)]
        if o.I is None:
            tests.append((of_y, fastest_alone_hz))
        alone = [signal for signal, shown_hz in tests if shown_hz(self._z[..., signal], o) is not None]
        self._paths = {PATHS[k]: self._cell(everywhere, slice(k * n, (k + 1) * n), alone) for k in self._signals}
        self._channels = {
            (SIGNALS[k], a, b): self._cell(o.axis == b, slice(k * n + a, k * n + a + 1), alone)
            for k in self._signals
            for b in sorted(set(o.axis.tolist()))
            for a in range(n)
        }
        # together with the channels of other paths, those of one that shows it are diluted
        self._shown = shows(self._z, o) or any(cell.shown for cell in self._paths.values())

    def shrinkage(self, after: Rig) -> Shrinkage:
        """Closure from the twin before to the twin ``after``: of the whole, and of every path and channel."""
        z = residual(after, self._o)
        paths = {name: self._closed(cell, z) for name, cell in self._paths.items()}
        channels = {name: self._closed(cell, z) for name, cell in self._channels.items()}
        noisy = [k for k in self._signals if max(paths[PATHS[k]].before, paths[PATHS[k]].after) > J_OF_EXACT]
        cells = [self._paths[PATHS[k]] for k in noisy or self._signals]
        b = np.mean([cell.before for cell in cells], axis=0)
        a = np.mean([self._per_point(z, cell.points, cell.columns) for cell in cells], axis=0)
        whole = _closed(b, a, self._o.line, self._drawn, self._shown)
        return Shrinkage(
            whole.before, whole.after, whole.closure, whole.closure_95, self._name, J_OF_NOISE, paths, channels
        )

    def _cell(self, points: NDArray[np.bool_], columns: slice, alone: Sequence[slice]) -> _Cell:
        o = self._o
        of_points = replace(o, line=o.line[points], axis=o.axis[points])
        shown = shows(self._z[points][..., columns], of_points) or columns in alone
        return _Cell(points, columns, self._per_point(self._z, points, columns), shown)

    def _closed(self, cell: _Cell, z: Complex) -> Closed:
        after = self._per_point(z, cell.points, cell.columns)
        return _closed(cell.before, after, self._o.line[cell.points], self._drawn, cell.shown)

    def _per_point(self, z: Complex, points: NDArray[np.bool_], columns: slice) -> Real:
        return _per_point(z[points][..., columns], self._known[points][..., columns])


def shows(z: Complex, o: Observation) -> bool:
    """Whether weighted residuals (P, H, k) are significant, in a band and channel or all together."""
    return max(significance(z, o), overall(z)) > SIGNIFICANT


def _per_point(z: Complex, known: NDArray[np.bool_]) -> Real:
    """|residual|^2 / variance of each point, mean over what was measured, (P,)."""
    power = np.abs(z) ** 2 / 2 * known
    return np.asarray(power.sum(axis=(1, 2)) / np.maximum(known.sum(axis=(1, 2)), 1))


def _drawn(lines: int, seed: int) -> Real:
    """How often each line is drawn in each bootstrap resample, (resamples, lines)."""
    return np.random.default_rng(seed).multinomial(lines, np.full(lines, 1 / lines), RESAMPLES).astype(float)


def _closed(before: Real, after: Real, line: NDArray[np.int64], drawn: Real, shown: bool) -> Closed:
    """Closure and interval from each point's J before and after, (P,); ``shown``: whether the gap is significant."""
    J_b, J_a = float(before.mean()), float(after.mean())
    closure = closure_of(J_b, J_a) if shown else None
    if closure is None:
        return Closed(J_b, J_a, None, (None, None))
    lines = drawn.shape[1]
    sums = np.stack([np.bincount(line, x, lines) for x in (before, after, np.ones(len(line)))], axis=1)
    b, a, count = (drawn @ sums).T
    with np.errstate(divide="ignore", invalid="ignore"):  # resamples without a line or without a gap are left out
        closures = np.minimum(1.0, 1.0 - (a / count - J_OF_NOISE) / (b / count - J_OF_NOISE))
    return Closed(J_b, J_a, closure, interval_95(closures[b > J_OF_NOISE * count], int((count > 0).sum())))


def interval_95(closures: Sequence[float] | Real, resamples: int) -> tuple[float | None, float | None]:
    """95 % interval of resampled closures; open below where one resample in forty shows no gap at all."""
    if not len(closures):
        return None, None
    low, high = (float(q) for q in np.quantile(closures, [0.025, 0.975]))
    return (None if len(closures) < 0.975 * resamples else low), high


def relative_gap(rig: Rig, o: Observation) -> float:
    """||measured - twin|| / ||measured|| of the fundamentals, of each signal by itself; rms over the signals."""
    z, w, m = residual(rig, o), weights(o), measured(o)
    return _relative(np.where(w > 0, z / np.maximum(w, 1e-300), 0), m, o, rig.n_axes)


def relative_noise(o: Observation, n_axes: int) -> float:
    """The relative gap that noise alone makes."""
    w = weights(o)
    return _relative(np.where(w > 0, np.sqrt(2) / np.maximum(w, 1e-300), 0), measured(o), o, n_axes)


def _relative(e: NDArray[np.complex128] | Real, m: NDArray[np.complex128], o: Observation, n: int) -> float:
    f = o.fundamental
    shares = []
    for k in range(3):
        size = np.linalg.norm(m[:, f, k * n : (k + 1) * n])
        if size > 0:
            shares.append(float(np.linalg.norm(e[:, f, k * n : (k + 1) * n]) / size) ** 2)
    return float(np.sqrt(np.mean(shares)))
