"""Where the tones of a sweep lie: grids that keep off spectral lines, and blocks of whole periods."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Aim, Limits, Profile

Real = NDArray[np.float64]

MAINS_HZ = (50.0, 60.0)
DIGITS = 9
"""Decimals of a grid's frequencies, Hz: a processor's last digit decides neither which of equal gaps is the widest, nor
to which side of a line a tone moves."""
CLEARANCE_HZ = 4.0
"""Most that a tone keeps off a line: less than half the distance between the two mains frequencies."""


def grid(from_hz: float, to_hz: float, n: int) -> Real:
    """``n`` log-spaced frequencies, both ends included."""
    found = np.geomspace(from_hz, to_hz, n)
    found[1:-1] = np.round(found[1:-1], DIGITS)
    return found


def mains_harmonics(up_to_hz: float) -> Real:
    """Multiples of both mains frequencies, rising."""
    return np.unique(np.concatenate([b * np.arange(1, 2 + int(up_to_hz / b)) for b in MAINS_HZ]))


def off_lines(frequency_hz: Real, resolution_hz: float, lines_hz: Real) -> Real:
    """Frequencies moved off spectral lines, in order and none twice.

    A frequency closer to a line than ``resolution_hz`` (one over the length of a whole record) moves to that
    distance: there the line's leakage into the record is zero. Where lines are so close that their bands overlap it
    moves out of all of them.
    """
    f = np.array(frequency_hz, dtype=float)
    for low, high in _forbidden(lines_hz, resolution_hz):
        inside = (f > low) & (f < high)
        f[inside] = np.where(f[inside] - low <= high - f[inside], low, high)
    return np.unique(f)


def _forbidden(lines_hz: Real, resolution_hz: float) -> list[tuple[float, float]]:
    """Bands round lines, those that overlap joined, rising."""
    bands: list[tuple[float, float]] = []
    for line in np.sort(lines_hz):
        low, high = float(line - resolution_hz), float(line + resolution_hz)
        if bands and low < bands[-1][1]:
            bands[-1] = (bands[-1][0], max(high, bands[-1][1]))
        else:
            bands.append((low, high))
    return bands


def clear_grid(from_hz: float, to_hz: float, n: int, resolution_hz: float, lines_hz: tuple[float, ...]) -> Real:
    """``n`` frequencies, log-spaced but for spectral lines (mains, and those of the noise record).

    What was moved onto its neighbour is put where the widest gaps are instead.
    """
    lines = np.unique(np.concatenate([mains_harmonics(to_hz), np.array(lines_hz, dtype=float)]))
    step = (to_hz / from_hz) ** (1 / max(1, n - 1))
    moved = off_lines(grid(from_hz, to_hz, n), resolution_hz, lines)
    moved = moved[(moved >= from_hz) & (moved <= to_hz)]
    kept = moved[np.concatenate([[True], np.diff(np.log(moved)) > np.log(step) / 3])]
    gaps = list(pairwise(kept))
    while len(kept) < n and gaps:
        gaps.sort(key=lambda g: g[1] / g[0])
        low, high = gaps.pop()
        middle = math.sqrt(low * high)
        if np.min(np.abs(lines - middle)) >= resolution_hz:
            kept = np.append(kept, middle)
            gaps += [(low, middle), (middle, high)]
    return np.sort(kept)


def whole_periods(
    frequency_hz: float,
    block_s: float,
    sample_rate_hz: float,
    tolerance_hz: float = np.inf,
    highest_hz: float = np.inf,
    most_samples: float = np.inf,
) -> tuple[int, int]:
    """Periods and samples of a block of about ``block_s`` whose frequency is periods * rate / samples.

    The block is the shortest, not shorter than ``block_s``, that comes within ``tolerance_hz``, or, where none up to
    half as long again (and at least thirty periods more) does, the one that comes nearest. Without a tolerance it is
    the shortest. It never comes out above ``highest_hz``, which a controller would refuse; nor has it more than
    ``most_samples``, unless a single period has.

    >>> whole_periods(100.0, 0.05, 10_000.0)
    (5, 500)
    """
    first = max(1, math.ceil(frequency_hz * block_s - 1e-9))
    last = max(first + 30, int(1.5 * first))
    if most_samples < np.inf:
        last = max(1, min(last, math.floor(frequency_hz * (most_samples - 1) / sample_rate_hz)))
        first = min(first, last)
    best, best_error = (first, 0), np.inf
    for periods in range(first, last + 1):
        samples = max(2, round(periods * sample_rate_hz / frequency_hz))
        if periods * sample_rate_hz > highest_hz * samples:
            samples += 1
        error = abs(periods * sample_rate_hz / samples - frequency_hz)
        if error < best_error - 1e-12:
            best, best_error = (periods, samples), error
        if error <= tolerance_hz:
            break
    return best


def resolution_hz(profile: Profile, aim: Aim) -> float:
    """One over the length of a whole record: the distance at which a line leaks nothing into it."""
    return min(1 / (profile.blocks * aim.block_s), CLEARANCE_HZ)


def main_grid(profile: Profile, limits: Limits, aim: Aim, lines_hz: tuple[float, ...]) -> Real:
    """Frequencies of the main sweep before peaks are known."""
    to = min(profile.to_hz, limits.max_frequency_hz)
    if profile.frequencies_hz:
        given = np.unique(np.array(profile.frequencies_hz, dtype=float))
        return given[given <= limits.max_frequency_hz]
    return clear_grid(profile.from_hz, to, profile.points, resolution_hz(profile, aim), lines_hz)


def amplifier_grid(profile: Profile, limits: Limits, aim: Aim, lines_hz: tuple[float, ...]) -> Real:
    """Frequencies of the amplifier sweep: up to 3 kHz, or what the controller can do."""
    to = min(profile.amplifier_to_hz, limits.max_frequency_hz)
    return clear_grid(profile.from_hz, to, profile.amplifier_points, resolution_hz(profile, aim), lines_hz)


def validation_grid(profile: Profile, aim: Aim, measured_hz: Real, lines_hz: tuple[float, ...]) -> Real:
    """Frequencies between those of the main sweep, spread over its whole length, peaks included.

    Gaps of the measured frequencies are halved, evenly chosen by number, so that where the main sweep is dense this
    one is too.
    """
    f = np.unique(measured_hz)
    middle = np.sqrt(f[1:] * f[:-1])
    n = min(profile.validation_points, len(middle))
    chosen = np.unique(np.round(np.linspace(0, len(middle) - 1, n)).astype(int))
    lines = np.unique(np.concatenate([mains_harmonics(f[-1]), np.array(lines_hz, dtype=float)]))
    return off_lines(middle[chosen], resolution_hz(profile, aim), lines)
