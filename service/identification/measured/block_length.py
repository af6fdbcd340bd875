"""How long the blocks of a sweep are, where its file does not say so.

Lines are mostly chosen so that a block of whole periods is a whole number of samples. The shortest such number is then
read from each frequency, the blocks are whole multiples of it, and as all blocks of a sweep are about equally long, to
one period, few lines leave but one length. Where they leave its double too, it is the one to which every block is the
nearest number of periods.
"""

from __future__ import annotations

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
AWAY = (0.55, 1.0)
"""How many periods a block may be longer or shorter than the others: as few as the nearest whole number needs, or one,
where whole samples were looked for."""


def block_samples(sweep: Sweep) -> Real | None:
    """Length of each point's blocks, (P,) samples, as the file has it, or as the lines tell it; None where they do not.

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
    return None if told is None else np.asarray(told[place], dtype=float)


def shortest(frequency_hz: Real, sample_rate_hz: float) -> NDArray[np.int64]:
    """Smallest number of samples that is whole periods of each line (F,), Hz; (F,), 0 where there is none."""
    n = np.arange(1, LONGEST + 1)
    periods = frequency_hz[:, None] / sample_rate_hz * n
    whole = (np.abs(periods - np.round(periods)) < EXACT * np.maximum(periods, 1.0)) & (periods > 0.5)
    return np.asarray(np.where(whole.any(axis=1), n[whole.argmax(axis=1)], 0), dtype=np.int64)


def told_by(frequency_hz: Real, sample_rate_hz: float) -> NDArray[np.int64] | None:
    """Samples of the blocks at each line (F,), Hz, (F,), or None where the lines leave none or several lengths."""
    least = shortest(frequency_hz, sample_rate_hz)
    if np.mean(least > 0) < COMMON:
        return None
    lengths = np.arange(1, LONGEST + 1)[:, None]
    unit = np.maximum(least, 1)
    nearest = np.maximum(1, np.round(lengths / unit)) * unit
    for away in AWAY:
        fits = (np.abs(nearest - lengths) < away * sample_rate_hz / frequency_hz) & (least > 0)
        agreed = np.flatnonzero(fits.mean(axis=1) >= COMMON)
        if len(agreed) and agreed[-1] <= 1.5 * (agreed[0] + 1):
            break
    else:
        return None
    middle = agreed[len(agreed) // 2]
    periods = np.maximum(1, np.round(nearest[middle] / sample_rate_hz * frequency_hz))
    otherwise = np.round(periods * sample_rate_hz / frequency_hz)
    return np.asarray(np.where(fits[middle], nearest[middle], otherwise), dtype=np.int64)
