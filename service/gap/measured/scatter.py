"""Noise of a sweep from the scatter of its blocks: variances of the mean residuals of u, i and y."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.block_ends import NEIGHBOURS, mean_variance_ratio
from service.gap.measured.coherent import deviation
from service.gap.measured.estimate import Estimate, plain_mean
from sim.harmonic_balance import time_points
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

OWN_SCATTER = 3.0
"""Ratio of a point's variance to its neighbours' beyond which it keeps its own: by chance 1 in 1000 for six blocks."""
WELL_DRIVEN = 100.0
"""Largest condition number of the input signals of a line, one column per driven axis, from which a response is
estimated."""


def smooth_variance(v: Real, frequency_hz: Real, dof: Real, width: int = NEIGHBOURS) -> Real:
    """Variance pooled over neighbouring frequencies, (P, H, n): a block variance alone has few degrees of freedom.

    ``dof`` is the number of complex degrees of freedom of each point's scatter, (P,).
    """
    order = np.argsort(frequency_hz, kind="stable")
    # Median over mean of a variance with 2 d degrees of freedom (Wilson and Hilferty 1931).
    median_over_mean = (1 - 1 / (9 * dof)) ** 3
    sorted_v = np.log(np.maximum((v / median_over_mean.reshape(-1, *(1,) * (v.ndim - 1)))[order], 1e-300))
    pad = min(width, len(order) - 1)
    padded = np.pad(sorted_v, ((pad, pad), *((0, 0),) * (v.ndim - 1)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * pad + 1, axis=0)
    pooled = np.empty_like(v)
    pooled[order] = np.exp(np.median(windows, axis=-1))
    # A point that scatters far more than its neighbours (a transient in one block) keeps its own variance.
    return np.where(v > OWN_SCATTER * pooled, v, pooled)


def block_scatter(sweep: Sweep, rig: Rig) -> tuple[Real, Real, Real]:
    """Variance of the mean residual of u, i and y, blocks taken as independent, (P, H, n) each, A^2 and m^2.

    i is zero where it was not logged. Residuals are those of `unexplained`.
    """
    of_u, of_i, of_y = (_variance(e) for e in unexplained(sweep, rig))
    return of_u, of_i, of_y


def mean_scatter(sweep: Sweep, rig: Rig, by: Estimate | None = None) -> tuple[Real, Real, Real]:
    """The same with the correlation of consecutive blocks (`block_ends`), pooled over neighbouring frequencies.

    ``by`` is the estimate that the means are of, where it is not the plain mean over the blocks.
    """
    by = by or plain_mean(*sweep.Y.shape[:2])
    scatter = unexplained(sweep, rig)
    of_u, of_i, of_y = (np.zeros((e.shape[0], *e.shape[2:])) for e in scatter)
    if not sweep.in_sequence:  # blocks are not consecutive
        of_u, of_i, of_y = (smooth_variance(_variance(e), sweep.frequency_hz, by.dof) for e in scatter)
        return of_u, of_i, of_y
    plain = by.dof == sweep.Y.shape[1] - 1  # points with a hum in their scatter are pooled with their like
    for points in (np.flatnonzero(plain), np.flatnonzero(~plain)):
        if len(points):
            for out, e in zip((of_u, of_i, of_y), scatter, strict=True):
                out[points] = _of_means(e[points], sweep.frequency_hz[points], by.select(points))
    return of_u, of_i, of_y


def _of_means(e: Complex, frequency_hz: Real, by: Estimate) -> Real:
    """Variance of the means of points that are pooled, from their deviations (P, B, H, n)."""
    pooled = smooth_variance(_variance(e), frequency_hz, by.dof)
    ratios = [mean_variance_ratio(e[:, :, k], pooled[:, k], frequency_hz, by) for k in range(e.shape[2])]
    return np.asarray(pooled * (by.spread[:, None] * np.stack(ratios, axis=1))[..., None])


def unexplained(sweep: Sweep, rig: Rig) -> tuple[Complex, Complex, Complex]:
    """Deviations of the blocks' residuals, output - G input, from their mean, for u, i and y, (P, B, H, n), A and m.

    Noise that feedback carries into the input is in the output too, and a stiff loop suppresses it in y; taking G input
    off removes that part. At the excited frequency G is the response measured at that line, where every axis was
    driven; elsewhere it is that of ``rig`` (any reasonable twin). i is zero where it was not logged.
    """
    frequency, line = time_points(sweep.frequency_hz)
    u, i, y = (np.zeros(sweep.Y.shape, dtype=complex) for _ in range(3))
    for k, h in enumerate(sweep.harmonics):
        model = linear_model(rig, np.maximum(h * frequency, 1e-2))
        R, U, Y = sweep.R[:, :, k], sweep.U[:, :, k], sweep.Y[:, :, k]
        C = np.broadcast_to(-model.controllers[:, :, None] * np.eye(rig.n_axes), model.y_per_u.shape)

        def residual(output: Complex, cause: Complex, G: Complex, h: int = h) -> Complex:
            if h == 1:
                measured, known = _response(output, cause, line, len(frequency))
                G = np.where(known[:, None, None], measured, G)
            return np.asarray(deviation(output) - np.einsum("pij,pbj->pbi", G[line], deviation(cause)))

        y[:, :, k] = residual(Y, U, model.y_per_u)
        u[:, :, k] = residual(U - R, Y, C)
        if sweep.I is not None:
            i[:, :, k] = residual(sweep.I[:, :, k], U, model.i_per_u)
    return u, i, y


def _variance(e: Complex) -> Real:
    """Variance of the mean of independent blocks from their deviations, (P, B, ...) -> (P, ...)."""
    return np.asarray(np.mean(np.abs(e) ** 2, axis=1) / (e.shape[1] - 1))


def _response(
    effect: Complex, cause: Complex, line: NDArray[np.int64], lines: int
) -> tuple[Complex, NDArray[np.bool_]]:
    """Measured response (F, n, n) of one signal to another, blocks (P, B, n), and at which lines it is known, (F,)."""
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
