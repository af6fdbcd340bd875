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


def wander(rig: Rig, means: tuple[Complex, Complex, Complex], sd: Real, k: int, f: int, sweep: Sweep) -> Real:
    """Standard deviation that the magnets' remanence adds to the mean displacement, beyond the noise, (P, n), m.

    A magnet's remanent flux pulls to the side to which the current last went, which is random. Deterministic static
    forces are regressed out: to second order a x^2 + b x i + c i^2 of the axes' amplitudes at the excited frequency,
    and a constant per line. The variance of the residuals, pooled over neighbouring lines, less ``sd`` squared is the
    wander.

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
    return np.asarray(np.sqrt(np.maximum(out - sd**2, 0.0)))
