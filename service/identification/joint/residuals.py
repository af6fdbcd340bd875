"""What a joint fit looks at: residuals of a plane's points in units of their measured noise, and their slopes.

Residuals are e = [A U - I; P A U - Y]. In closed loop the controller computes u, so u is known exactly and
carries no noise of its own; what scatters is i and y, and the scatter of exactly these residuals is what
they are weighted with. That is maximum likelihood, errors in variables included, and takes each point by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real
from service.identification.measured.data import Data
from service.identification.measured.noise import NoiseModel, block_noise
from service.identification.measured.points import PlanePoints
from service.identification.plane import amplifier
from service.identification.plane.jacobian import amplifier_gradient, displacement_gradient, extended_gradient
from service.identification.plane.model import PlaneModel
from service.identification.plane.motion import Motion
from service.identification.plane.prediction import Amplitude, Points
from service.identification.statistics.whitening import Whitener, whitener


@dataclass(frozen=True)
class Weights:
    """Whitening of the residuals, one per data set."""

    plant: Whitener
    """For [i_A, i_B, y_A, y_B], or [y_A, y_B] without currents."""
    amplifier: Whitener | None
    """For [i_A, i_B]."""


def residual_blocks(points: PlanePoints, i: Complex, y: Complex) -> Complex:
    """[I - i, Y - y] of each block, (P, B, 4), or (P, B, 2) without currents; i and y (P, B, 2) or (P, 1, 2)."""
    parts = [] if points.I is None else [points.I - i]
    return np.concatenate([*parts, points.Y - y], axis=2)


def predicted_blocks(model: PlaneModel, points: PlanePoints, amplitude: Amplitude | None) -> tuple[Complex, Complex]:
    """Model's i and y for each block's own u, (P, B, 2) each: the mean's prediction, and the small signal beyond it."""
    if amplitude is not None and amplitude.products is not None and len(amplitude.products) == points.n_blocks:
        # the blocks are realisations: each has its own phases, and with them its own cubic terms
        each = [
            model.predict(
                Points(points.omega, points.U[:, b]), replace(amplitude, products=amplitude.products[b : b + 1])
            )
            for b in range(points.n_blocks)
        ]
        return np.stack([p.i for p in each], axis=1), np.stack([p.y for p in each], axis=1)
    mean = model.predict(Points(points.omega, points.u), amplitude)
    away = points.U - points.u[:, None, :]
    i = mean.i[:, None, :] + away * model.amplifier_response(points.omega, base_band=False)[:, None, :]
    y = mean.y[:, None, :] + np.einsum("pyu,pbu->pby", model.response(points.omega), away)
    return i, y


def noise_of(
    model: PlaneModel,
    points: PlanePoints,
    amplitude: Amplitude | None,
    rings: Real | None = None,
    correlated: bool = True,
    block_s: Real | None = None,
) -> NoiseModel:
    """Noise of the residuals under a model, with what is not known of what rang and was taken out.

    ``rings``, ``correlated``, ``block_s``: see `measured.noise.block_noise`.
    """
    i, y = predicted_blocks(model, points, amplitude)
    size = y if points.I is None else np.concatenate([i, y], axis=2)
    left = points.unsettled
    noise = block_noise(
        residual_blocks(points, i, y),
        points.omega,
        correlated,
        magnitude=np.abs(size.mean(axis=1)),
        suspect=points.suspect,
        sparse=points.many is not None,
        rings=rings,
        unknown=None if left is None else left.scatter,
        block_s=block_s,
    )
    return noise if left is None else replace(noise, covariance=noise.covariance + left.mean)


def weights_of(
    model: PlaneModel, data: Data, amplitude: Amplitude | None, relative: float = 0.0
) -> tuple[Weights, NoiseModel]:
    """Whitening by the measured noise.

    ``relative`` adds that share of the model's own magnitude to each standard deviation, to make a first search
    forgiving of what is still wrong; 0 for the estimate itself.
    """
    noise = noise_of(model, data.plant, amplitude)
    covariance = noise.covariance
    if relative:
        p = model.predict(Points(data.plant.omega, data.plant.u), amplitude)
        size = p.y if data.plant.I is None else np.hstack([p.i, p.y])
        seen = data.plant.y if data.plant.I is None else np.hstack([data.plant.I.mean(axis=1), data.plant.y])
        extra = (relative * np.maximum(np.abs(size), np.abs(seen))) ** 2
        covariance = covariance + extra[:, :, None] * np.eye(extra.shape[1])
    plant = whitener(covariance)
    currents = None
    if data.amplifier is not None and data.amplifier.I is not None:
        i = model.amplifier_response(data.amplifier.omega, base_band=False)[:, None, :] * data.amplifier.U
        of_currents = block_noise(data.amplifier.I - i, data.amplifier.omega)
        currents = whitener(of_currents.covariance)
    return Weights(plant, currents), noise


def residuals(
    model: PlaneModel,
    data: Data,
    weights: Weights,
    amplitude: Amplitude | None,
    gradient: bool = True,
    free: NDArray[np.bool_] | None = None,
) -> tuple[Real, Real | None]:
    """Whitened residuals of the means, model less measured, unit variance each, and their Jacobian.

    Parameters
    ----------
    free
        (size,) the parameters to which the Jacobian is wanted; by default all.

    Returns
    -------
    residual, jacobian
        (N,) and (N, n): plant's points first, channel by channel, the real and the imaginary part of a point together;
        what the datasheet says last.
    """
    wanted = np.ones(model.layout.size, dtype=bool) if free is None else free
    points = data.plant
    motion = model.motion(points.at, amplitude, gradient)
    currents = None if points.i is None else motion.i
    rows = [_whitened(points, currents, motion.y, weights.plant)]
    slopes = [_whitened_slopes(model, points, motion, weights.plant, wanted)] if gradient else []
    if weights.amplifier is not None and data.amplifier is not None and data.amplifier.i is not None:
        e, d_e = _amplifier_residual(model, data.amplifier, gradient)
        rows.append(weights.amplifier.applied(e).view(np.float64).ravel())
        if gradient:
            slopes.append(_real_rows(weights.amplifier.applied(d_e[wanted])))
    for told in (data.prior, data.released):
        if told is None:
            continue
        e_prior, d_prior = told.rows(model)
        rows.append(e_prior)
        slopes.append(d_prior.T[wanted])
    return np.concatenate(rows), np.concatenate(slopes, axis=1).T if gradient else None


def _whitened(points: PlanePoints, i: Complex | None, y: Complex, white: Whitener) -> Real:
    """Residuals of the means in units of the noise, from i and y (2, P)."""
    e = y - points.y_rows
    if i is not None and points.i_rows is not None:
        e = np.concatenate([i - points.i_rows, e])
    return np.asarray(white.applied(e).view(np.float64).ravel())


def _whitened_slopes(
    model: PlaneModel, points: PlanePoints, motion: Motion, white: Whitener, wanted: NDArray[np.bool_]
) -> Real:
    """Their slope to the wanted parameters, (n, N); what no such parameter moves is not made."""
    layout = model.layout
    d_y = displacement_gradient(model, motion)
    of_currents = slice(layout.amplifiers[0].start, layout.delay + 1)
    d_i: Complex | None = None
    if wanted[of_currents].any():
        d_i = np.zeros((layout.size, *motion.i.shape), dtype=np.complex128)
        amplifier_gradient(model, points.at, motion, d_i, d_y)
    if wanted[layout.given].any():
        extended_gradient(model, motion, d_y)
    d_y = motion.folding.folded(d_y[wanted])
    if points.i is None:
        return _real_rows(white.applied(d_y))
    out = np.zeros((len(d_y), 4, d_y.shape[2]), dtype=np.complex128)
    white.add(d_y, 2, out)
    if d_i is not None:  # a block of parameters beside one another
        start = int(wanted[: of_currents.start].sum())
        place = slice(start, start + int(wanted[of_currents].sum()))
        white.add(d_i[of_currents][wanted[of_currents]], 0, out[place])
    return _real_rows(out)


def _real_rows(slopes: Complex) -> Real:
    """(n, c, P) as (n, N), a point's real and imaginary part together."""
    return np.asarray(slopes.view(np.float64).reshape(len(slopes), -1))


def _amplifier_residual(model: PlaneModel, points: PlanePoints, gradient: bool) -> tuple[Complex, Complex]:
    """A U - I, (2, P), and its slope to every parameter, (size, 2, P)."""
    assert points.i_rows is not None
    delay, period = model.delay_s + model.known.computing_delay_s, model.known.sample_time_s
    u = points.at.u_rows
    i = np.empty_like(u)
    d = np.zeros((model.layout.size if gradient else 0, *u.shape), dtype=np.complex128)
    for j, place in enumerate(model.layout.amplifiers):
        response, slope = amplifier.sampled(points.omega, model.theta[place], delay, period)
        i[j] = response * u[j]
        if gradient:
            d[place, j] = slope[:, :-1].T * u[j]
            d[model.layout.delay, j] = slope[:, -1] * u[j]
    return i - points.i_rows, d
