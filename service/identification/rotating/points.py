"""The points of one speed, all axes together, with what turns with the rotor taken out.

Runout and unbalance put lines at multiples of the speed into every signal. At a point near to one they leak into each
block with a phase that advances from block to block by n W times the block's length, which is known; so the leak is
regressed out of the blocks, at the price of one of their degrees of freedom. Where the line is so near that it looks
as the excitation does, the point is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.identification.arrays import Complex, Real
from service.identification.measured.points import SUSPECT, UNUSABLE, Blocks
from service.identification.measured.sweeps import speed_of
from sim.errors import AmbError

ORDERS = (1, 2, 3)
"""Multiples of the speed that are looked for."""
SEEN = 3.0
"""Share of the blocks' scatter that a line explains, in shares of chance, from which it is there."""
NEAR_BLOCKS = 30.0
"""Distance, in reciprocal block lengths, within which a line is looked for."""
PHASES = 16
"""Phases of the excitation that are tried first."""
LEAK = 0.2
"""Leak into a mean, in its standard deviations, that is let pass."""
INFLATION = 25.0
"""Growth of the variance of a mean above which its point is left out instead of notched."""
UNKNOWN_LENGTH = 0.05
"""Relative distance to a line within which points are left out where the length of the blocks is not known."""


@dataclass(frozen=True)
class SynchronousLine:
    """What a multiple of the speed was found to do to a sweep."""

    order: int
    seen: bool
    amplitude_m: Real
    """(n_axes,) of the line in y; nan where it was not seen."""
    notched: int
    left_out: int


@dataclass(frozen=True, kw_only=True)
class SpeedPoints(Blocks):
    """All usable points of one sweep at one speed."""

    name: str
    speed_rad_s: float
    axes: tuple[str, ...]
    lines: tuple[SynchronousLine, ...] = ()
    left_out: tuple[str, ...] = ()
    inflation: Real | None = None
    """(P,) what notching does to the variance of the means; None for nothing."""

    @cached_property
    def speed(self) -> Real:
        """(P,) rad/s."""
        return np.full(len(self.omega), self.speed_rad_s)

    def select(self, keep: NDArray[np.bool_]) -> Self:
        """Some of the points."""
        kept = super().select(keep)
        return replace(kept, inflation=None if self.inflation is None else self.inflation[keep])


def speed_points(sweep: Sweep, axes: tuple[str, ...], name: str) -> SpeedPoints:
    """Usable points of a sweep, by frequency, synchronous lines rejected.

    Raises
    ------
    AmbError
        Fewer than three blocks or no harmonic 1, an axis without enough points.
    """
    if 1 not in sweep.harmonics or sweep.U.shape[1] < 3:
        raise AmbError(
            f"{name}: the excited line in at least 3 blocks is needed to tell what turns with the rotor from what "
            "the excitation does; measure more blocks"
        )
    h = sweep.harmonic(1)
    signals = [s[:, :, h, :] for s in (sweep.U, sweep.Y, sweep.I) if s is not None]
    flags = sweep.flags or ("",) * sweep.n_points
    good = np.all([np.isfinite(x).all(axis=(1, 2)) for x in signals], axis=0)
    good &= (sweep.amplitude_a > 0) & (sweep.frequency_hz > 0)
    good &= np.array([not any(word in f.lower() for word in UNUSABLE) for f in flags], dtype=bool)
    keep = np.flatnonzero(good)
    keep = keep[np.lexsort((sweep.axis[keep], sweep.frequency_hz[keep]))]
    u, y, *i = (np.ascontiguousarray(x[keep], dtype=complex) for x in signals)
    points = SpeedPoints(
        name=name,
        speed_rad_s=speed_of(sweep),
        axes=axes,
        omega=2 * np.pi * sweep.frequency_hz[keep].astype(float),
        axis=sweep.axis[keep].astype(np.int64),
        U=u,
        I=i[0] if i else None,
        Y=y,
        suspect=np.array([any(word in flags[p].lower() for word in SUSPECT) for p in keep], dtype=bool),
    )
    samples = None if sweep.block_samples is None else sweep.block_samples[keep]
    points = without_synchronous(points, samples, 1.0 / sweep.sample_rate_hz)
    counts = np.bincount(points.axis, minlength=len(axes))
    if counts.min() < 8:
        short = axes[int(np.argmin(counts))]
        raise AmbError(f"{name}: {counts.min()} usable points excite {short}; at least 8 of each axis are needed")
    return points


def without_synchronous(points: SpeedPoints, block_samples: NDArray[np.int64] | None, period_s: float) -> SpeedPoints:
    """The same points with lines at multiples of the speed regressed out of the blocks, or left out.

    Parameters
    ----------
    block_samples
        (P,) length of each point's blocks, samples of ``period_s``; None when it is not known.
    """
    if not points.speed_rad_s:
        return points
    if block_samples is None:
        return _without_near(points)
    total = np.ones(len(points.omega), dtype=bool)
    inflation = np.ones(len(points.omega))
    found = []
    for order in ORDERS:
        line = _Line(points, order, block_samples, period_s)
        if not line.is_seen:
            blank = np.full(len(points.axes), np.nan)
            # without a line of its own amount there is nothing to reject but points that sit upon it
            out = line.on_it if order == 1 else np.zeros_like(line.on_it)
            found.append(SynchronousLine(order, False, blank, 0, int(np.sum(out & total))))
            total &= ~out
            continue
        notched, factor = line.notch_factor()
        out = notched & (factor > INFLATION) | line.on_it
        rows = notched & ~out
        points = line.notched(points, rows)
        inflation[rows] *= factor[rows]
        found.append(
            SynchronousLine(order, True, line.amplitude_m, int(np.sum(rows & total)), int(np.sum(out & total)))
        )
        total &= ~out
    text = tuple(
        f"{points.name}: {line.left_out} points too near {line.order} x the speed left out"
        for line in found
        if line.left_out
    )
    points = replace(points, lines=tuple(found), left_out=text, inflation=inflation)
    return points.select(total)


def _without_near(points: SpeedPoints) -> SpeedPoints:
    near = np.min(
        [np.abs(points.omega / (n * abs(points.speed_rad_s)) - 1) for n in ORDERS[:2]],
        axis=0,
    )
    keep = near > UNKNOWN_LENGTH
    text = f"{points.name}: {int(np.sum(~keep))} points within {100 * UNKNOWN_LENGTH:g} % of synchronous lines left out"
    return replace(points.select(keep), left_out=() if keep.all() else (text,))


class _Line:
    """One multiple of the speed in the blocks of a sweep.

    A line Re(D exp(j n W t)) leaks into block b as exp(-j phi) (D a_b + conj(D) c_b): a and c are the means of the
    line's two rotations against the excited one over the block, phi is the phase of the excitation at the record's
    start, which demodulation has taken out. phi is one for all signals of a point and is searched for.
    """

    def __init__(self, points: SpeedPoints, order: int, block_samples: NDArray[np.int64], period_s: float) -> None:
        self.order = order
        line, blocks = order * points.speed_rad_s, points.U.shape[1]
        turn = np.exp(1j * line * period_s * block_samples[:, None] * np.arange(blocks))
        self._a = _mean_turn(line - points.omega, block_samples, period_s)[:, None] * turn
        self._c = _mean_turn(-line - points.omega, block_samples, period_s)[:, None] * turn.conj()
        block_s = block_samples * period_s
        away = np.abs(abs(line) - points.omega)  # a real line is at either sign of its frequency
        self.on_it = away * block_s * blocks < np.pi
        signals = [points.Y, points.U] + ([] if points.I is None else [points.I])
        x = np.concatenate(signals, axis=2)
        self._basis, self._size, share, self._noise = self._regressed(x)
        centred = self._basis - self._basis.mean(axis=3, keepdims=True)
        self._gram = np.einsum("pdrb,perb->pde", centred, centred)
        kept = np.sqrt(np.mean(np.abs(self._a) ** 2 + np.abs(self._c) ** 2, axis=1))
        tells = (away * block_s < 2 * np.pi * NEAR_BLOCKS) & (kept > 0.005)
        tells &= np.linalg.eigvalsh(self._gram)[:, 0] > 0.1 * blocks * kept**2
        nearest = np.argsort(away)
        telling = nearest[tells[nearest]][:24]
        chance = 1.0 / (blocks - 1)
        # the nearest points show a line most; noise alone keeps to its share everywhere
        self.is_seen = bool(
            len(telling) >= 8 and np.median(share[telling].mean(axis=1)) > min(SEEN * chance, 0.5 * (1 + chance))
        )
        found = np.abs(self._size[:, 0] + 1j * self._size[:, 1])
        self._amplitude = np.median(found[telling], axis=0) if len(telling) else np.zeros(x.shape[2])
        self.amplitude_m = self._amplitude[: len(points.axes)]

    def _regressed(self, x: Complex) -> tuple[Real, Real, Real, Real]:
        """Basis (P, 2, 2, B) for D's two parts, D (P, 2, C), its share of the scatter (P, C), noise of the means."""
        blocks = x.shape[1]
        spread = x - x.mean(axis=1, keepdims=True)
        whole = np.maximum(np.sum(np.abs(spread) ** 2, axis=1), 1e-300)
        z = np.concatenate([spread.real, spread.imag], axis=1)  # (P, 2 B, C)
        best: tuple[Real, Real, Real] | None = None
        phase = np.zeros(len(x))
        for step, count in ((np.pi / PHASES, PHASES), (np.pi / PHASES / 8, 17)):
            centre = phase
            for k in range(count):
                phi = centre + (k if best is None or count == PHASES else k - count // 2) * step
                basis = self._waves(phi)
                centred = basis - basis.mean(axis=3, keepdims=True)
                flat = centred.reshape(len(x), 2, -1)
                gram = flat @ flat.swapaxes(1, 2)
                gram = gram + 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(2) + 1e-30 * np.eye(2)
                right = flat @ z
                size = np.linalg.solve(gram, right)
                share = np.sum(right * size, axis=1) / whole
                if best is None:
                    best = basis, size, share
                    continue
                better = share.mean(axis=1) > best[2].mean(axis=1)
                phase = np.where(better, phi, phase)
                for old, new in zip(best, (basis, size, share), strict=True):
                    old[better] = new[better]
        assert best is not None
        left = np.maximum(whole * (1 - best[2]), 1e-300)
        return *best, np.sqrt(left / max(blocks - 2, 1) / blocks)

    def _waves(self, phi: Real) -> Real:
        back = np.exp(-1j * phi)[:, None]
        waves = np.stack([back * (self._a + self._c), 1j * back * (self._a - self._c)], axis=1)  # (P, 2, B)
        return np.stack([waves.real, waves.imag], axis=2)

    def notch_factor(self) -> tuple[NDArray[np.bool_], Real]:
        """Points whose means the line moves, and what taking it out does to the variance of their means."""
        blocks = self._a.shape[1]
        leak = np.abs(self._a.mean(axis=1)) + np.abs(self._c.mean(axis=1))
        moved = np.any(leak[:, None] * self._amplitude > LEAK * self._noise, axis=1)
        mean = self._basis.mean(axis=3)
        gram = self._gram + 1e-30 * np.eye(2)
        spent = np.einsum("pdr,pdr->p", mean, np.linalg.solve(gram, mean))
        return moved, 1.0 + 0.5 * blocks * spent

    def notched(self, points: SpeedPoints, rows: NDArray[np.bool_]) -> SpeedPoints:
        """The points with the line taken out of the blocks of ``rows``, their scatter as of blocks without a line."""
        blocks = self._a.shape[1]
        grow = np.sqrt((blocks - 1) / max(blocks - 2, 1))
        n = len(points.axes)
        leak = np.einsum("pdrb,pdc->prbc", self._basis[rows], self._size[rows])
        leaks = leak[:, 0] + 1j * leak[:, 1]

        def clean(signal: Complex, place: int) -> Complex:
            out = signal.copy()
            x = signal[rows] - leaks[:, :, place * n : (place + 1) * n]
            mean = x.mean(axis=1, keepdims=True)
            out[rows] = mean + grow * (x - mean)
            return out

        current = None if points.I is None else clean(points.I, 2)
        return replace(points, Y=clean(points.Y, 0), U=clean(points.U, 1), I=current)


def _mean_turn(omega: Real, samples: NDArray[np.int64], period_s: float) -> Complex:
    """Mean of exp(j w t) over a block that begins at t = 0, (P,)."""
    half = 0.5 * omega * period_s
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.where(np.abs(np.sin(half)) < 1e-12, 1.0, np.sin(half * samples) / (samples * np.sin(half)))
    return np.asarray(size * np.exp(1j * half * (samples - 1)))
