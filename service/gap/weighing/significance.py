"""Significance of residuals: tests of the worst band and channel, of single lines, and of all residuals together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_tail, normal_above, normal_tail
from service.gap.fitting.part import Part
from service.gap.fitting.predict import TINY_WEIGHT, weight
from service.gap.measured.observation import Observation

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

SIGNIFICANT = 5.0
"""Normal deviate, after Bonferroni's correction for bands and channels, from which there is a gap."""
OUTLIER = 12.0
"""Largest squared residual (over its expectation) with which a single value counts."""

NEARLY_NORMAL = 32
"""Values of a cell from which their mean square is treated as normal: at five deviates the true tail is 28 times as
heavy with ten values, and twice with 32."""
ALONE_CHI_SQUARE = 2 * OUTLIER
"""Squared residual (over its expectation) that two values of one line must exceed for that line alone to show a gap."""
CLIPPED_CHI_SQUARE = 2000.0
"""The same for the controller, whose law is known exactly, but which a rig that still rings seems to break: of 330
experiments of other programs it did so by 170 at most, and by 34000 or more where a log or the output was clipped."""
PEAKED = 0.01
"""Share of a line's displacement by which two programs' peaks differ: a mode of quality 500 whose frequency differs by
some 1e-5."""
MOSTLY_OPPOSITE = 0.25
"""Share of what planes do to one another oppositely that they may do alike: bearings, sensors and magnets differ."""
LINE_BY_CHANCE = 1e-19
"""Probability that noise makes such a line of some dozen values."""


def significance(z: Complex, o: Observation, n_bands: int = 6, bound: float = OUTLIER) -> float:
    """Largest excess of the mean square over bands and channels, as a one-sided normal deviate after Bonferroni.

    ``z`` are weighted residuals, (P, H, channels); each value counts up to ``bound``. Residuals of the points of one
    line are correlated by what is left of the twin's error, so a cell counts as half as many independent values.
    """
    edges = np.quantile(o.frequency_hz, np.linspace(0, 1, n_bands + 1))
    which = np.clip(np.searchsorted(edges, o.points_hz, side="right") - 1, 0, n_bands - 1)
    return worst([z[which == band] for band in range(n_bands)], bound)


def worst(cells: Sequence[Complex], bound: float = np.inf, looked_at: int = 1) -> float:
    """Significance of the worst channel of some cells (points of a band), weighted residuals (points, channels..) each.

    ``looked_at`` is the number of tests for each channel of each cell, for Bonferroni's correction.
    """
    deviates = []
    for z in cells:
        # A few outliers at a sharp peak are not a gap: each value counts up to a bound.
        cell = np.minimum(np.abs(z) ** 2 / 2, bound)  # mean one
        if not len(cell):
            continue
        deviates.append(_deviate(cell.reshape(len(cell), -1).mean(axis=0), len(cell) / 2))
    if not deviates:
        return 0.0
    values = np.concatenate(deviates)
    largest = float(values.max())
    if largest > 30:
        return largest
    p = min(1.0, float(normal_tail(largest)) * len(values) * looked_at)
    return float(max(normal_above(p), 0.0)) if p < 1 else 0.0


def _deviate(mean: Real, count: float) -> Real:
    """Normal deviate of the mean of ``count`` independent squared magnitudes of complex noise of unit mean square."""
    plain = (mean - 1.0) * np.sqrt(count)
    if 2 * count >= NEARLY_NORMAL:
        return np.asarray(plain)
    p = chi2_tail(2 * count * mean, 2 * count)
    return np.asarray(np.where(p > 0, normal_above(np.maximum(p, 1e-300)), plain))


def mean_power(z: Complex) -> float:
    """J, the mean square of weighted residuals over its expectation: 1 for noise. Zeros (no weight) are left out."""
    power = np.abs(z[z != 0]) ** 2 / 2
    return float(power.mean()) if power.size else 0.0


def shows_alone_hz(z: Complex, o: Observation, lines: Iterable[int] | None = None) -> float | None:
    """The line, Hz, of the largest second largest residual, if that exceeds `ALONE_CHI_SQUARE`; or None.

    For amplifiers, which may reach a voltage limit in one line only, so that the mean of its band hides it. Other parts
    have sharp peaks that look the same, so for them it is used with a few ``lines`` only. Two values are required, as
    one may be a transient.
    """
    off = np.abs(z) ** 2 / 2
    at, largest = 0, 0.0
    for line in range(len(o.frequency_hz)) if lines is None else lines:
        values = np.sort(off[o.line == line][:, [k for k, h in enumerate(o.harmonics) if h > 0]], axis=None)
        if len(values) > 1 and values[-2] > largest:
            at, largest = line, float(values[-2])
    return float(o.frequency_hz[at]) if largest > ALONE_CHI_SQUARE else None


def clipped_alone_hz(z: Complex, o: Observation) -> float | None:
    """The line, Hz, in which the controller's law fails by most, if in two points by `CLIPPED_CHI_SQUARE`; or None.

    Its output ends, or a log, in one line first, whichever axis is excited. One point alone may be a bad record.
    """
    of_points = (np.abs(z) ** 2 / 2).reshape(len(z), -1).max(axis=1)
    of_lines = [np.sort(of_points[o.line == line])[-2:] for line in range(len(o.frequency_hz))]
    second = np.array([two[0] if len(two) > 1 else 0.0 for two in of_lines])
    return float(o.frequency_hz[second.argmax()]) if second.max() > CLIPPED_CHI_SQUARE else None


def fastest_alone_hz(z: Complex, o: Observation) -> float | None:
    """The line with the steepest control signal, Hz, if it shows a gap by itself (`shows_alone_hz`); or None.

    For the plant with the amplifiers, where currents were not logged: a voltage limit is met in that line first.
    """
    steepness = np.abs(o.U[:, o.fundamental]).max(axis=1) * o.points_hz
    return shows_alone_hz(z, o, [int(o.line[np.argmax(steepness)])])


def furthest_alone_hz(z: Complex, o: Observation) -> float | None:
    """The line of an axis's largest displacement, Hz, if its fundamentals show a gap (`shows_alone_hz`); or None.

    For the plant: a stop is met in that line first, and perhaps in no other. Residuals below `PEAKED` of the line's
    displacement do not count, as a shifted peak could make them.
    """
    size = np.abs(o.Y[:, o.fundamental])
    of_line = np.array([size[o.line == line].max() for line in range(len(o.frequency_hz))])
    least = PEAKED * of_line[o.line, None] * weight(o, "y")[:, o.fundamental]
    counted = np.zeros_like(z)
    counted[:, o.fundamental] = np.where(np.abs(z[:, o.fundamental]) > least, z[:, o.fundamental], 0)
    return shows_alone_hz(counted, o, sorted({int(o.line[k]) for k in size.argmax(axis=0)}))


def whirling_alone_hz(z: Complex, o: Observation) -> float | None:
    """The line of a turning rotor, Hz, in which each plane moves the other, oppositely, far beyond noise; or None.

    For the plant: a gyroscopic moment, a seal and the shaft's own damping do so, and beside a sharp mode perhaps in no
    other line. A peak that is shifted does not; planes that differ move one another alike, and what still rings of the
    tone before is neither.
    """
    n, f = o.Y.shape[-1], o.fundamental
    half = n // 2
    if not o.speed_rad_s or half < 2:
        return None
    w = np.maximum(weight(o, "y")[:, f], TINY_WEIGHT)
    y = z[:, f] / w
    at, largest = None, 0.0
    for line in range(len(o.frequency_hz)):
        point = {int(o.axis[k]): int(k) for k in np.flatnonzero(o.line == line)}
        if len(point) < n:
            continue
        # from each end in x to each in y, and back from the same end in y
        pairs = [(point[a], half + b, point[half + a], b) for a in range(half) for b in range(half)]
        there, back = (np.array([y[p[k], p[k + 1]] for p in pairs]) for k in (0, 2))
        expected = np.array([2 / w[p, b] ** 2 + 2 / w[q, a] ** 2 for p, b, q, a in pairs])
        opposite, alike = (float((np.abs(there + sign * back) ** 2 / expected).mean()) for sign in (-1, 1))
        if opposite > largest and alike < MOSTLY_OPPOSITE * opposite:
            at, largest = float(o.frequency_hz[line]), opposite
    return at if largest > ALONE_CHI_SQUARE else None


def alone_hz(part: Part, z: Complex, o: Observation) -> float | None:
    """The line, Hz, in which a part shows a gap by itself, as a limit, a clip, a stop or a whirl makes it; or None."""
    if part.path == "amplifier":
        return shows_alone_hz(z, o)
    if part.path == "controller":
        return clipped_alone_hz(z, o)
    if part.path != "plant":
        return None
    steepest = fastest_alone_hz(z, o) if part.from_control else None
    alone = (hz for of in (furthest_alone_hz, whirling_alone_hz) if (hz := of(z, o)) is not None)
    return next(alone, None) if steepest is None else steepest


def overall(z: Complex) -> float:
    """Excess of the mean square of all residuals as a normal deviate: it shows a small misfit in every cell.

    As in `significance`, a value counts half and up to a bound. Zeros (no weight) are left out.
    """
    size = np.minimum(np.abs(z[z != 0]) ** 2 / 2, OUTLIER)
    return float((size.mean() - 1.0) * np.sqrt(size.size / 2)) if size.size else 0.0
