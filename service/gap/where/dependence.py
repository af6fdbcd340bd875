"""Does the gap depend on amplitude or speed: two sweeps at different conditions, held against each other.

A gap in proportion to the excitation is one transfer function, whatever the amplitude: the error over the measured
signal of the excited axis is then the same in both sweeps. Their lines differ, so the main sweep's is interpolated, and
what interpolation costs is told by leaving out each of its lines in turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.distributions import normal_above
from service.gap.fitting.predict import NOTHING_SEEN, NOTHING_TOLD, measured_signal, weight
from service.gap.measured.condition import conditions_of, lines_of
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import LINE_BY_CHANCE, SIGNIFICANT, alone_hz, overall, significance
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

ENOUGH_LINES = 4
"""Lines of an axis from which its error can be interpolated."""


@dataclass(frozen=True)
class Dependence:
    """Whether the gap depends on a condition; None where these data do not test it."""

    amplitude: bool | None = None
    speed: bool | None = None
    significance: float | None = None
    """of the change between the two sweeps, a normal deviate; None where they are at one condition"""


def dependence(e: Explained, other: Observation, distorted: bool) -> Dependence:
    """Whether a part's gap depends on amplitude and speed.

    Parameters
    ----------
    e
        The part, with what the plain twin leaves of the main sweep.
    other
        The whole other sweep.
    distorted
        A nonlinearity is proven at one amplitude already: by harmonics, or by what explains the gap.
    """
    amplitude, speed = conditions_of(e.ground.observations[0], other)
    change = change_between(e, other) if amplitude or speed else None
    differs = change is not None and change > SIGNIFICANT
    if amplitude and speed and differs:  # one of them, or both
        return Dependence(distorted or None, None, change)
    return Dependence(distorted or (differs if amplitude else None), differs if speed else None, change)


def change_between(e: Explained, other: Observation) -> float:
    """How far the plain twin's relative error differs between the two sweeps, beside noise and interpolation.

    A normal deviate; 0 for a difference that is no more than those.
    """
    main, (there, z_there) = e.ground.observations[0], on_sweep(e, e.null.candidate, other)
    signal, n = e.part.signal, e.ground.nuisance.rig.n_axes
    (error, variance), (error_there, variance_there) = (
        relative_error(z, o, signal) for z, o in ((e.plain[0], main), (z_there, there))
    )
    z = np.zeros((len(there.axis), 1, n), dtype=complex)
    known = np.zeros(len(there.axis), dtype=bool)
    for axis in np.unique(there.axis):
        hz, at = lines_of(main, int(axis))
        if len(hz) < ENOUGH_LINES:
            continue
        rows = np.flatnonzero((there.axis == axis) & (there.points_hz >= hz[0]) & (there.points_hz <= hz[-1]))
        expected, spread = interpolated(hz, error[at], variance[at], there.points_hz[rows])
        z[rows, 0] = np.sqrt(2) * (error_there[rows] - expected) / np.sqrt(variance_there[rows] + spread)
        known[rows] = True
    kept = replace(there, line=there.line[known], axis=there.axis[known])
    if alone_hz(e.part, z_there, there) is not None and alone_hz(e.part, e.plain[0], main) is None:
        return float(normal_above(LINE_BY_CHANCE))  # a limit that one line of one sweep reaches drowns in every band
    return max(significance(z[known], kept), overall(z[known]), 0.0)


def relative_error(z: Complex, o: Observation, signal: str) -> tuple[Complex, Real]:
    """Error of a twin over the measured signal of the excited axis, (P, n), and its variance."""
    f, points = o.fundamental, np.arange(len(o.axis))
    w = np.maximum(weight(o, signal)[:, f], NOTHING_TOLD)
    size = measured_signal(o, signal)[points, f, o.axis][:, None]
    size = np.where(size == 0, NOTHING_SEEN, size)  # a log so coarse that it shows no displacement at all
    return z[:, f] / w / size, 2 / (w * np.abs(size)) ** 2


def interpolated(hz: Real, values: Complex, variance: Real, at_hz: Real) -> tuple[Complex, Real]:
    """Values (F, n) at other frequencies, linear in log frequency, and their variance with interpolation's own error.

    Leaving a line out widens its interval to two, so the error found this way is rather too large.
    """
    x, at = np.log(hz), np.log(at_hz)
    share = ((x[1:-1] - x[:-2]) / (x[2:] - x[:-2]))[:, None]
    missed = np.abs(values[1:-1] - (1 - share) * values[:-2] - share * values[2:]) ** 2
    missed = np.concatenate([missed[:1], missed, missed[-1:]])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    s = ((at - x[k]) / (x[k + 1] - x[k]))[:, None]
    expected = (1 - s) * values[k] + s * values[k + 1]
    noise = (1 - s) ** 2 * variance[k] + s**2 * variance[k + 1]
    return expected, noise + np.maximum(missed[k], missed[k + 1])
