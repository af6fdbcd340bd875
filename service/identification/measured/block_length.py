"""How long the blocks of a sweep are, where its file does not say so.

Lines are mostly chosen so that a block of whole periods is a whole number of samples. The shortest such number is then
read from each frequency, the blocks are whole multiples of it, and as all blocks of a sweep are about equally long, to
one period, few lines leave but one length. Programs round the number of periods in a block to the nearest one, up or
down; where one way of rounding explains the lines and leaves one length, it is that one. Lines that leave several
lengths have those of another sweep of the same rig, which was planned alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.identification.arrays import Real

LONGEST = 5_000
"""Samples of a block, at most."""
EXACT = 1e-7
"""How far from whole a number of periods may be, relative: what rounding a frequency to single precision makes of it.
Chance meets one line in eight within `LONGEST` samples, and so never `COMMON` of them."""
COMMON = 0.95
"""Share of the lines that have to agree."""


@dataclass(frozen=True)
class Rounding:
    """How the number of periods in a block follows from the length that all blocks are to have."""

    whole: Callable[[Real], Real]
    away: float
    """how many periods a block may be longer or shorter than that length"""


ROUNDINGS = (Rounding(np.round, 0.55), Rounding(np.ceil, 1.0), Rounding(np.floor, 1.0), Rounding(np.round, 1.0))
"""To the nearest number of periods, up, down, or to the nearest one that is a whole number of samples: the first that
leaves one length. The last one explains whatever the second and the third do."""


@dataclass(frozen=True)
class Blocks:
    """How the blocks of a sweep were chosen: their common length, samples, and how it was rounded to periods."""

    length: int
    rounding: Rounding


def block_samples(sweep: Sweep, alike: Sweep | None = None) -> Real | None:
    """Length of each point's blocks, (P,) samples, as the file has it, or as the lines tell it; None where they do not.

    Lines that tell nothing are held against the choice of ``alike``, another sweep of the same program.

    >>> import numpy as np
    >>> lines = np.array([2, 3, 10, 11, 25, 31, 43, 47]) * 1e4 / np.array([589, 634, 501, 508, 518, 513, 511, 507])
    >>> shortest(lines, 1e4).tolist()
    [589, 634, 501, 508, 518, 513, 511, 507]
    >>> told_by(lines, 1e4).tolist()
    [589, 634, 501, 508, 518, 513, 511, 507]
    >>> rounded = np.array([1, 1, 3, 11, 25, 31, 43, 47])  # twice as long would do too, but for the rounding
    >>> told_by(rounded * 1e4 / np.array([910, 630, 520, 496, 505, 492, 501, 498]), 1e4).tolist()
    [910, 630, 520, 496, 505, 492, 501, 498]
    >>> told_by(np.array([100.0, 200.0, 500.0]), 1e4) is None
    True
    """
    if sweep.block_samples is not None:
        return np.asarray(sweep.block_samples, dtype=float)
    hz, place = np.unique(sweep.frequency_hz, return_inverse=True)
    if not len(hz) or hz[0] <= 0 or sweep.sample_rate_hz <= 0:
        return None
    told = told_by(hz, sweep.sample_rate_hz)
    if told is None and alike is not None and alike.sample_rate_hz == sweep.sample_rate_hz:
        chosen = chosen_by(np.unique(alike.frequency_hz[alike.frequency_hz > 0]), alike.sample_rate_hz)
        told = None if chosen is None else told_as(chosen, hz, sweep.sample_rate_hz)
    return None if told is None else np.asarray(told[place], dtype=float)


def shortest(frequency_hz: Real, sample_rate_hz: float) -> NDArray[np.int64]:
    """Smallest number of samples that is whole periods of each line (F,), Hz; (F,), 0 where there is none."""
    n = np.arange(1, LONGEST + 1)
    periods = frequency_hz[:, None] / sample_rate_hz * n
    whole = (np.abs(periods - np.round(periods)) < EXACT * np.maximum(periods, 1.0)) & (periods > 0.5)
    return np.asarray(np.where(whole.any(axis=1), n[whole.argmax(axis=1)], 0), dtype=np.int64)


def told_by(frequency_hz: Real, sample_rate_hz: float) -> NDArray[np.int64] | None:
    """Samples of the blocks at each line (F,), Hz, (F,), or None where the lines leave none or several lengths."""
    chosen = chosen_by(frequency_hz, sample_rate_hz)
    return None if chosen is None else told_as(chosen, frequency_hz, sample_rate_hz)


def told_as(chosen: Blocks, frequency_hz: Real, sample_rate_hz: float) -> NDArray[np.int64] | None:
    """Samples of blocks that were chosen so, at each line (F,), Hz, (F,), or None where the lines contradict it."""
    length = np.array([[chosen.length]])
    nearest, fits = _at_lengths(
        chosen.rounding, length, shortest(frequency_hz, sample_rate_hz), frequency_hz, sample_rate_hz
    )
    if fits.mean() < COMMON:
        return None
    periods = np.maximum(1, np.round(nearest[0] / sample_rate_hz * frequency_hz))
    otherwise = np.round(periods * sample_rate_hz / frequency_hz)
    return np.asarray(np.where(fits[0], nearest[0], otherwise), dtype=np.int64)


def chosen_by(frequency_hz: Real, sample_rate_hz: float) -> Blocks | None:
    """How the blocks at lines (F,), Hz, were chosen, or None where the lines leave none or several lengths."""
    least = shortest(frequency_hz, sample_rate_hz)
    if not len(least) or np.mean(least > 0) < COMMON:
        return None
    lengths = np.arange(1, LONGEST + 1)[:, None]
    for rounding in ROUNDINGS:
        _, fits = _at_lengths(rounding, lengths, least, frequency_hz, sample_rate_hz)
        share = fits.mean(axis=1)
        agreed = np.flatnonzero(share >= COMMON)
        if len(agreed) and agreed[-1] <= 1.5 * (agreed[0] + 1):
            return Blocks(_roundest(lengths[agreed[share[agreed] == share[agreed].max()], 0]), rounding)
    return None


def _roundest(lengths: NDArray[np.int64]) -> int:
    """Of lengths that explain the lines alike the one with the fewest digits, as programs state it; else the middle."""
    digits = np.array([len(str(n).rstrip("0")) for n in lengths.tolist()])
    few = lengths[digits == digits.min()]
    return int(few[len(few) // 2])


def _at_lengths(
    rounding: Rounding, lengths: NDArray[np.int64], least: NDArray[np.int64], frequency_hz: Real, sample_rate_hz: float
) -> tuple[Real, NDArray[np.bool_]]:
    """Blocks (L, F), samples, at lengths (L, 1), and which of them are as near to those as the rounding allows."""
    unit = np.maximum(least, 1)
    rounded = np.maximum(1, rounding.whole(lengths / unit)) * unit
    return rounded, (np.abs(rounded - lengths) < rounding.away * sample_rate_hz / frequency_hz) & (least > 0)
