"""Whether two sweeps were measured at different amplitudes or speeds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.measured.observation import Observation

Real = NDArray[np.float64]

ANOTHER_AMPLITUDE = 1.2
"""Ratio of amplitudes from which they count as different: the relative size of cubic terms of the magnets' force, which
goes with the square, then differs by 44 %; below, by less than two programs' laws of one effect."""
ANOTHER_SPEED = 0.01
"""Relative difference of speeds from which they count as different: a rig holds its speed better than that."""


def conditions_of(main: Observation, other: Observation) -> tuple[bool, bool]:
    """Whether two sweeps differ in amplitude, and whether in speed."""
    ratios = []
    for axis in np.unique(other.axis):
        (main_hz, main_points), (other_hz, other_points) = lines_of(main, int(axis)), lines_of(other, int(axis))
        if len(main_hz) > 1:
            in_main, in_other = _excitation(main)[main_points, axis], _excitation(other)[other_points, axis]
            ratios.append(np.log(in_other) - np.interp(np.log(other_hz), np.log(main_hz), np.log(in_main)))
    if not ratios:  # no axis is excited in several lines of both
        of_main, of_other = (np.median(np.log(_excitation(o)[np.arange(len(o.axis)), o.axis])) for o in (main, other))
        ratios = [np.array([of_other - of_main])]
    amplitude = bool(abs(np.median(np.concatenate(ratios))) > np.log(ANOTHER_AMPLITUDE))
    fastest = max(abs(main.speed_rad_s), abs(other.speed_rad_s))
    return amplitude, abs(main.speed_rad_s - other.speed_rad_s) > ANOTHER_SPEED * fastest


def _excitation(o: Observation) -> Real:
    """Amplitude of r, (P, n), A; not quite zero, as its logarithm is taken."""
    return np.asarray(np.maximum(np.abs(o.R[:, o.fundamental]), 1e-300))


def same_condition(main: Observation, other: Observation) -> str | None:
    """The note on two sweeps at the same amplitude and speed; None where they differ."""
    if any(conditions_of(main, other)):
        return None
    return (
        "both sweeps have the same amplitude and speed: closure is on other lines only, which is weaker than another "
        "condition; whether the gap depends on the speed was not tested, and on the amplitude by harmonics alone"
    )


def lines_of(o: Observation, axis: int) -> tuple[Real, NDArray[np.int64]]:
    """Frequencies at which an axis was excited, rising and distinct, and the points that did."""
    points = np.flatnonzero(o.axis == axis)
    hz, first = np.unique(o.points_hz[points], return_index=True)
    return hz, points[first]
