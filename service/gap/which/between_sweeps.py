"""How much the plain twin's error differs between two sweeps at different conditions.

A linear gap is one transfer function, whatever the amplitude: the plain twin's error over the measured signal of the
excited axis is the same in both sweeps. Their lines differ, so the main sweep's relative error is interpolated; the
error of interpolation is estimated by leaving out each line in turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.distributions import normal_above
from service.gap.fitting.predict import TINY_SIGNAL, TINY_WEIGHT, measured_signal, weight
from service.gap.measured.condition import lines_of
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import LINE_BY_CHANCE, alone_hz, overall, significance
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

ENOUGH_LINES = 4
"""Fewest lines of an axis from which its error is interpolated."""


def change_between(e: Explained, other: Observation) -> float:
    """Significance of the difference of the plain twin's relative error between the two sweeps, a normal deviate.

    Noise and the error of interpolation are allowed for; 0 for no difference beyond these.
    """
    main, (second, z_second) = e.ground.observations[0], on_sweep(e, e.null.candidate, other)
    signal, n = e.part.signal, e.ground.nuisance.rig.n_axes
    (error, variance), (error_second, variance_second) = (
        relative_error(z, o, signal) for z, o in ((e.plain[0], main), (z_second, second))
    )
    z = np.zeros((len(second.axis), 1, n), dtype=complex)
    compared = np.zeros(len(second.axis), dtype=bool)
    for axis in np.unique(second.axis):
        hz, at = lines_of(main, int(axis))
        if len(hz) < ENOUGH_LINES:
            continue
        rows = np.flatnonzero((second.axis == axis) & (second.points_hz >= hz[0]) & (second.points_hz <= hz[-1]))
        expected, expected_variance = interpolated(hz, error[at], variance[at], second.points_hz[rows])
        z[rows, 0] = np.sqrt(2) * (error_second[rows] - expected) / np.sqrt(variance_second[rows] + expected_variance)
        compared[rows] = True
    points = replace(second, line=second.line[compared], axis=second.axis[compared])
    lone = alone_hz(e.part, z_second, second)
    if lone is not None and next_to(lone, main.frequency_hz) and alone_hz(e.part, e.plain[0], main) is None:
        # The mean of a band hides a limit that one line of one sweep reaches. A linear gap may show in
        # one line alone, too, but then what explains it explains that line.
        left = on_sweep(e, e.chosen, other)[1]
        if alone_hz(e.part, left, second) is not None:
            return float(normal_above(LINE_BY_CHANCE))
    return max(significance(z[compared], points), overall(z[compared]), 0.0)


def next_to(at_hz: float, lines_hz: Real) -> bool:
    """Whether some lines (F,) are so near that they would have shown what a line at ``at_hz`` shows.

    The nearest is no farther than its neighbour.

    >>> lines_hz = np.array([100.0, 120.0, 144.0])
    >>> [next_to(at_hz, lines_hz) for at_hz in (80.0, 90.0, 130.0, 170.0, 430.0)]
    [False, True, True, True, False]
    """
    x = np.sort(np.log(lines_hz))
    if len(x) < 2:
        return False
    apart, nearest = np.diff(x), int(np.abs(x - np.log(at_hz)).argmin())
    return bool(abs(x[nearest] - np.log(at_hz)) <= apart[max(nearest - 1, 0) : nearest + 1].max())


def relative_error(z: Complex, o: Observation, signal: str) -> tuple[Complex, Real]:
    """Error of a twin over the measured signal of the excited axis, (P, n), and its variance, (P, n).

    ``z`` are weighted residuals, (P, H, n).
    """
    f, points = o.fundamental, np.arange(len(o.axis))
    w = np.maximum(weight(o, signal)[:, f], TINY_WEIGHT)
    size = measured_signal(o, signal)[points, f, o.axis][:, None]
    size = np.where(size == 0, TINY_SIGNAL, size)  # the log may be too coarse to show any displacement
    return z[:, f] / w / size, 2 / (w * np.abs(size)) ** 2


def interpolated(hz: Real, values: Complex, variance: Real, at_hz: Real) -> tuple[Complex, Real]:
    """Values (F, n) interpolated linearly in log frequency, and their variance, with the error of interpolation.

    That error is the squared one at a line that is left out. It is an upper estimate, as the interval is then doubled.
    """
    x, at = np.log(hz), np.log(at_hz)
    share = ((x[1:-1] - x[:-2]) / (x[2:] - x[:-2]))[:, None]
    left_out = np.abs(values[1:-1] - (1 - share) * values[:-2] - share * values[2:]) ** 2
    left_out = np.concatenate([left_out[:1], left_out, left_out[-1:]])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    s = ((at - x[k]) / (x[k + 1] - x[k]))[:, None]
    expected = (1 - s) * values[k] + s * values[k + 1]
    noise = (1 - s) ** 2 * variance[k] + s**2 * variance[k + 1]
    return expected, noise + np.maximum(left_out[k], left_out[k + 1])
