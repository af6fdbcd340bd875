"""How long the blocks of a sweep are, where its file does not say so.

Lines are mostly chosen so that a block of whole periods is a whole number of samples. The shortest such number is then
read from each frequency, the blocks are whole multiples of it, and as all blocks of a sweep are about equally long, to
one period, few lines leave but one length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.identification.zoh import Real

LONGEST = 5_000
"""Samples of a block, at most."""
EXACT = 1e-7
"""How far from whole a number of periods may be, relative: what rounding a frequency to single precision makes of it.
Chance meets one line in eight within `LONGEST` samples, and so never `COMMON` of them."""
COMMON = 0.95
"""Share of the lines that have to agree."""


def block_samples(sweep: Sweep) -> Real | None:
    """Length of each point's blocks, (P,) samples, as the file has it, or as the lines tell it; None where they do not.

    >>> import numpy as np
    >>> lines = np.array([2, 3, 10, 11, 25, 31, 43, 47]) * 1e4 / np.array([589, 634, 501, 508, 518, 513, 511, 507])
    >>> shortest(lines, 1e4).tolist()
    [589, 634, 501, 508, 518, 513, 511, 507]
    >>> told_by(lines, 1e4).tolist()
    [589, 634, 501, 508, 518, 513, 511, 507]
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
    fits = (np.abs(nearest - lengths) < sample_rate_hz / frequency_hz) & (least > 0)
    agreed = np.flatnonzero(fits.mean(axis=1) >= COMMON)
    if not len(agreed) or agreed[-1] > 1.5 * (agreed[0] + 1):
        return None
    middle = agreed[len(agreed) // 2]
    periods = np.maximum(1, np.round(nearest[middle] / sample_rate_hz * frequency_hz))
    otherwise = np.round(periods * sample_rate_hz / frequency_hz)
    return np.asarray(np.where(fits[middle], nearest[middle], otherwise), dtype=np.int64)
