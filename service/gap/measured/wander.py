"""Random wander of the mean displacement, as magnets keep some flux (remanence) after a large swing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from sim.harmonic_balance import STATIC_HZ
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

NEIGHBOURS = 4
"""Lines to either side of a point over which the variance of the wander is pooled."""
NORMAL_MEDIAN = 0.455
"""Median of the square of a normal deviate."""
QUIET = 0.05
"""Share of a plane's largest amplitudes of displacement and current below which it is at rest: static forces, which go
with their squares, are a 400th of the largest there."""
STEP_SHOWN = 6.0
"""Standard deviations of its estimate from which a step of the mean displacement is one."""
STEP_OF_LOAD = 0.01
"""Share of an axis's largest static deflection from which such a step is no error of the law of static forces."""


def wander(rig: Rig, means: tuple[Complex, Complex, Complex], sd: Real, k: int, f: int, sweep: Sweep) -> Real:
    """Standard deviation that the magnets' remanence adds to the mean displacement, beyond the noise, (P, n), m.

    A magnet's remanent flux pulls to the side to which the current last went, which is random. Deterministic static
    forces are regressed out: to second order a x^2 + b x i + c i^2 of the axes' amplitudes at the excited frequency,
    and a constant per line. The variance of the residuals, pooled over neighbouring lines, less ``sd`` squared is the
    wander; and what a large swing left behind while other axes were excited (`_left_behind`).

    Parameters
    ----------
    means : u, i and y, (P, H, n) each
    sd : of the mean displacement, (P, n)
    k, f : indices of harmonics 0 and 1
    """
    U, I, Y = means
    line = np.unique(sweep.frequency_hz, return_inverse=True)[1]
    load = (Y[:, k] - U[:, k] @ linear_model(rig, np.array([STATIC_HZ])).y_per_u[0].T).real
    x, i = Y[:, f], I[:, f]
    laws = np.concatenate([np.abs(x) ** 2, (x * i.conj()).real, np.abs(i) ** 2], axis=1)
    per_line = 1.0 * (line[:, None] == np.arange(line.max() + 1))
    columns = np.concatenate([laws / np.maximum(np.abs(laws).max(axis=0), 1e-300), per_line], axis=1)
    dof = len(load) - columns.shape[1]
    if dof < laws.shape[1]:
        return np.zeros_like(load)
    residuals = np.zeros_like(load)
    for c in range(load.shape[1]):
        weighted, target = columns / sd[:, [c]], load[:, c] / sd[:, c]
        residuals[:, c] = (target - weighted @ np.linalg.lstsq(weighted, target, rcond=None)[0]) * sd[:, c]
    power, out = residuals**2 * len(load) / dof, np.zeros_like(load)
    for a in np.unique(sweep.axis):
        points = np.flatnonzero(sweep.axis == a)
        points = points[np.argsort(line[points], kind="stable")]
        size = min(NEIGHBOURS, len(points) - 1)
        padded = np.pad(power[points], ((size, size), (0, 0)), mode="reflect")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * size + 1, axis=0)
        out[points] = np.median(windows, axis=-1) / NORMAL_MEDIAN
    return np.asarray(np.sqrt(np.maximum(out - sd**2, 0.0) + _left_behind(load, x, i, sd) ** 2))


def _left_behind(load: Real, x: Complex, i: Complex, sd: Real) -> Real:
    """What swings of a plane have left of its mean displacements once the other plane is excited, (n,), m; 0 for none.

    A magnet stays where its last large swing has left it, for as many lines as the other plane has. From there its own
    static forces, which go with the squares of its tones, lead back to where it was before: that is the step.
    """
    steps, half = np.zeros(load.shape[1]), load.shape[1] // 2
    for plane in [slice(0, half), slice(half, None)] if half > 1 else []:
        sizes = [
            np.abs(signal[:, plane]) / np.maximum(np.abs(signal[:, plane]).max(axis=0), 1e-300) for signal in (x, i)
        ]
        quiet = np.all(np.concatenate(sizes, axis=1) < QUIET, axis=1)
        own_x, own_i = x[~quiet, plane], i[~quiet, plane]
        laws = np.concatenate([np.abs(own_x) ** 2, (own_x * own_i.conj()).real, np.abs(own_i) ** 2], axis=1)
        laws = np.column_stack([np.ones(len(laws)), laws / np.maximum(np.abs(laws).max(axis=0), 1e-300)])
        dof = len(laws) - laws.shape[1]
        if dof < laws.shape[1] or np.count_nonzero(quiet) < laws.shape[1]:
            continue
        for c in range(load.shape[1])[plane]:
            own, rest = load[~quiet, c], float(np.median(load[quiet, c]))
            by, *_ = np.linalg.lstsq(laws, own, rcond=None)
            scatter = float(np.linalg.norm(own - laws @ by)) / np.sqrt(dof)
            uncertain = scatter * np.sqrt(np.linalg.pinv(laws.T @ laws)[0, 0])
            step, largest = abs(rest - by[0]), float(np.abs(load[:, c] - rest).max())
            if step > STEP_SHOWN * np.hypot(uncertain, float(np.median(sd[:, c]))) and step > STEP_OF_LOAD * largest:
                steps[c] = step
    return steps
