"""The scatter of a sweep's blocks: what a model leaves of u, i and y, and the variance of its mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.block_ends import NEIGHBOURS, share
from service.gap.measured.coherent import deviation
from service.gap.measured.estimate import Estimate, plain_mean
from sim.harmonic_balance import time_points
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

OWN_SCATTER = 3.0
"""Ratio of a point's variance to its neighbours' beyond which it counts as its own: 1 in 1000 for six blocks."""
WELL_DRIVEN = 100.0
"""Condition of the signals of a line, one column for each driven axis, up to which they tell a response."""


def smooth_variance(v: Real, frequency_hz: Real, free: Real, width: int = NEIGHBOURS) -> Real:
    """Variance pooled over neighbouring frequencies, (P, H, n): a block variance alone has few degrees of freedom.

    ``free`` has the complex dimensions of each point's scatter, (P,).
    """
    order = np.argsort(frequency_hz, kind="stable")
    # The median of a variance of 2 d degrees of freedom sits a little below the mean (Wilson and Hilferty 1931).
    of_mean = (1 - 1 / (9 * free)) ** 3
    sorted_v = np.log(np.maximum((v / of_mean.reshape(-1, *(1,) * (v.ndim - 1)))[order], 1e-300))
    pad = min(width, len(order) - 1)
    padded = np.pad(sorted_v, ((pad, pad), *((0, 0),) * (v.ndim - 1)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * pad + 1, axis=0)
    pooled = np.empty_like(v)
    pooled[order] = np.exp(np.median(windows, axis=-1))
    # A point that scatters far more than its neighbours (a transient in one block) keeps its own variance.
    return np.where(v > OWN_SCATTER * pooled, v, pooled)


def block_scatter(sweep: Sweep, rig: Rig) -> tuple[Real, Real, Real]:
    """Variance of the mean over independent blocks of what a model leaves of u, i and y, (P, H, n) each, A^2 and m^2.

    i is zero where it was not logged. See `unexplained`.
    """
    of_u, of_i, of_y = (_variance(e) for e in unexplained(sweep, rig))
    return of_u, of_i, of_y


def mean_scatter(sweep: Sweep, rig: Rig, by: Estimate | None = None) -> tuple[Real, Real, Real]:
    """The same over the blocks as they follow one another, pooled over neighbouring frequencies.

    ``by`` is how the means were estimated, where that was not from the blocks alike.

    What blocks' ends leave cancels from one to the next: where a loop is stiff, most of what a model from u to y leaves
    in one block at low frequencies.
    """
    by = by or plain_mean(*sweep.Y.shape[:2])
    scatter = unexplained(sweep, rig)
    of_u, of_i, of_y = (np.zeros((e.shape[0], *e.shape[2:])) for e in scatter)
    if not sweep.in_sequence:  # none began where another ended
        of_u, of_i, of_y = (smooth_variance(_variance(e), sweep.frequency_hz, by.free) for e in scatter)
        return of_u, of_i, of_y
    alike = by.free == sweep.Y.shape[1] - 1  # where a hum could not be taken off, it is in the scatter
    for points in (np.flatnonzero(alike), np.flatnonzero(~alike)):
        if len(points):
            for out, e in zip((of_u, of_i, of_y), scatter, strict=True):
                out[points] = _of_means(e[points], sweep.frequency_hz[points], by.select(points))
    return of_u, of_i, of_y


def _of_means(e: Complex, frequency_hz: Real, by: Estimate) -> Real:
    """Variance of the means of points whose deviations, (P, B, H, n), tell of one another's."""
    pooled = smooth_variance(_variance(e), frequency_hz, by.free)
    shares = [share(e[:, :, k], pooled[:, k], frequency_hz, by) for k in range(e.shape[2])]
    return np.asarray(pooled * (by.spread[:, None] * np.stack(shares, axis=1))[..., None])


def unexplained(sweep: Sweep, rig: Rig) -> tuple[Complex, Complex, Complex]:
    """Blocks' deviations from their mean of what a model leaves of u, i and y, (P, B, H, n) each, A and m.

    Feedback carries the noise of y round, and a stiff loop hides it in y; a model of what lies between two signals
    takes that part out. At the excited frequency the data give it where every axis was driven, whatever the rig is.
    Elsewhere it is that of ``rig`` (any reasonable twin). i is zero where it was not logged.
    """
    frequency, line = time_points(sweep.frequency_hz)
    u, i, y = (np.zeros(sweep.Y.shape, dtype=complex) for _ in range(3))
    for k, h in enumerate(sweep.harmonics):
        model = linear_model(rig, np.maximum(h * frequency, 1e-2))
        R, U, Y = sweep.R[:, :, k], sweep.U[:, :, k], sweep.Y[:, :, k]
        C = np.broadcast_to(-model.controller[:, None, None] * np.eye(rig.n_axes), model.y_per_u.shape)

        def left(X: Complex, V: Complex, G: Complex, cause: Complex, effect: Complex, h: int = h) -> Complex:
            if h == 1:
                measured, known = _response(effect, cause, line, len(frequency))
                G = np.where(known[:, None, None], measured, G)
            return np.asarray(deviation(X) - np.einsum("pij,pbj->pbi", G[line], deviation(V)))

        y[:, :, k] = left(Y, U, model.y_per_u, U, Y)
        u[:, :, k] = left(U - R, Y, C, Y, U - R)
        if sweep.I is not None:
            I = sweep.I[:, :, k]
            i[:, :, k] = left(I, U, model.i_per_u, U, I)
    return u, i, y


def _variance(e: Complex) -> Real:
    return np.asarray(np.mean(np.abs(e) ** 2, axis=1) / (e.shape[1] - 1))


def _response(
    effect: Complex, cause: Complex, line: NDArray[np.int64], lines: int
) -> tuple[Complex, NDArray[np.bool_]]:
    """Response (F, n, n) of one signal to another, blocks (P, B, n), and which lines tell it, (F,)."""
    n = effect.shape[2]
    E, C = (np.zeros((lines, n, n), dtype=complex) for _ in range(2))
    known = np.bincount(line, minlength=lines) == n
    of = np.flatnonzero(known[line])
    order = of[np.argsort(line[of], kind="stable")].reshape(-1, n)
    E[known], C[known] = effect.mean(axis=1)[order].swapaxes(1, 2), cause.mean(axis=1)[order].swapaxes(1, 2)
    known[known] = np.linalg.cond(C[known]) < WELL_DRIVEN
    G = np.zeros_like(E)
    G[known] = E[known] @ np.linalg.inv(C[known])
    return G, known
