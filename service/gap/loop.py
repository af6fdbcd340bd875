"""What the gap means for the loop: sensitivity peaks predicted and measured, and the nu-gap by frequency."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.gap.observation import Observation
from service.gap.predict import at_speed_of
from sim.rig import Rig
from sim.twin import linear_model

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def measured_responses(o: Observation) -> tuple[Complex, Complex, Real] | None:
    """u/r and y/u at the lines where every axis was excited, (F, n, n) each, and those frequencies; else None."""
    n, f = o.U.shape[2], o.fundamental
    lines = [k for k in range(len(o.frequency_hz)) if set(o.axis[o.line == k].tolist()) == set(range(n))]
    if len(lines) < 3:
        return None
    R, U, Y = (np.empty((len(lines), n, n), dtype=complex) for _ in range(3))
    for row, k in enumerate(lines):
        for point in np.flatnonzero(o.line == k):
            column = o.axis[point]
            R[row, :, column], U[row, :, column], Y[row, :, column] = o.R[point, f], o.U[point, f], o.Y[point, f]
    return _right_divided(U, R), _right_divided(Y, U), o.frequency_hz[lines]


def _right_divided(a: Complex, b: Complex) -> Complex:
    """A B^-1 for stacks of matrices."""
    quotient = np.linalg.solve(np.swapaxes(b, 1, 2), np.swapaxes(a, 1, 2))
    return np.asarray(np.swapaxes(quotient, 1, 2))


def chordal_distance(a: Complex, b: Complex) -> Real:
    """Pointwise nu-gap of two loop matrices, (F, n, n) -> (F,): 0 equal, 1 as far apart as can be.

    Source: Vinnicombe, Uncertainty and Feedback, 2001, eq. 3.20.
    """

    def inverse_root(x: Complex) -> Complex:
        values, vectors = np.linalg.eigh(np.eye(x.shape[-1]) + x)
        return np.asarray((vectors / np.sqrt(values)[:, None, :]) @ np.conj(np.swapaxes(vectors, -1, -2)))

    left = inverse_root(b @ np.conj(np.swapaxes(b, -1, -2)))
    right = inverse_root(np.conj(np.swapaxes(a, -1, -2)) @ a)
    return np.asarray(np.linalg.norm(left @ (b - a) @ right, ord=2, axis=(1, 2)))


def loop_figures(before: Rig, after: Rig, o: Observation) -> dict[str, Any]:
    """Sensitivity peak of each axis on the measured lines, and the largest nu-gap of the loop, before and after."""
    found = measured_responses(o)
    if found is None:
        return {}
    S, G, frequency = found
    axes = before.axes
    peaks: dict[str, Any] = {"measured": dict(zip(axes, _peaks(S), strict=True))}
    gaps: dict[str, Any] = {"frequency_hz": frequency.tolist()}
    for name, rig in (("before", before), ("after", after)):
        model = linear_model(at_speed_of(rig, o), frequency)
        peaks[name] = dict(zip(axes, _peaks(model.sensitivity), strict=True))
        C = model.controller[:, None, None]
        distance = chordal_distance(C * model.y_per_u, C * G)
        gaps[name] = distance.tolist()
        gaps[f"largest_{name}"] = float(distance.max())
    return {"sensitivity_peak": peaks, "nu_gap": gaps}


def _peaks(S: Complex) -> list[float]:
    diagonal = np.abs(np.diagonal(S, axis1=1, axis2=2))
    return [float(p) for p in diagonal.max(axis=0)]
