"""At which amplitude and speed a sweep was measured, held against another one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.measured.observation import Observation

Real = NDArray[np.float64]

ANOTHER_AMPLITUDE = 1.2
"""Ratio of amplitudes from which a sweep is at another one: the cubic terms of the magnets' force, which grow with its
square, then change by 44 %; below, by less than what two laws of one effect differ (`UNEXPLAINED`)."""
ANOTHER_SPEED = 0.01
"""The same, relative, of speeds: a rig's speed is held to better than that."""


def conditions_of(main: Observation, other: Observation) -> tuple[bool, bool]:
    """Whether two sweeps differ in amplitude, and whether in speed."""
    ratios = []
    for axis in np.unique(other.axis):
        (hz, points), (at, points_there) = lines_of(main, int(axis)), lines_of(other, int(axis))
        if len(hz) > 1:
            own, there = _drive(main)[points, axis], _drive(other)[points_there, axis]
            ratios.append(np.log(there) - np.interp(np.log(at), np.log(hz), np.log(own)))
    amplitude = bool(ratios) and bool(abs(np.median(np.concatenate(ratios))) > np.log(ANOTHER_AMPLITUDE))
    fastest = max(abs(main.speed_rad_s), abs(other.speed_rad_s))
    return amplitude, abs(main.speed_rad_s - other.speed_rad_s) > ANOTHER_SPEED * fastest


def _drive(o: Observation) -> Real:
    """Amplitude of the excitation, (P, n), A; no less than rounding."""
    return np.asarray(np.maximum(np.abs(o.R[:, o.fundamental]), 1e-300))


def same_condition(main: Observation, other: Observation) -> str | None:
    """What to say of an unseen sweep that is no other condition."""
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
