"""Joint refinement of a plane: everything at once, in units of the measured noise.

Residuals are e = [I - A U; Y - P A U]. In closed loop the controller computes u, so u is known exactly and
carries no noise of its own; what scatters is i and y, and the scatter of exactly these residuals is what
they are weighted with. That is maximum likelihood, errors in variables included, and takes each point by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.least_squares import Fit, minimise
from service.identification.noise import NoiseModel, block_noise
from service.identification.plane_model import Amplitude, PlaneModel, Points, Prediction
from service.identification.points import PlanePoints
from service.identification.split import Knowledge, Split, held_rows
from service.identification.tolerances import Tolerances
from service.identification.zoh import Complex, Real

NEAR, FAR = 1.5, 10.0
"""Displacement of a bearing over that of the sensors, at most: while modes are counted, and in the end."""


@dataclass(frozen=True)
class Data:
    """What a joint fit looks at: the plane's points, and points that tell of the amplifiers only."""

    plant: PlanePoints
    amplifier: PlanePoints | None = None
    prior: Tolerances | None = None
    """What the datasheet says, where it is asked to tell beside the data."""


@dataclass(frozen=True)
class Weights:
    """Whitening of the residuals, one per data set."""

    plant: Complex
    """(P, c, c) for [i_A, i_B, y_A, y_B], or [y_A, y_B] without currents."""
    amplifier: Complex | None
    """(P, 2, 2) for [i_A, i_B]."""


@dataclass(frozen=True)
class Refined:
    """A refined plane."""

    model: PlaneModel
    fit: Fit
    noise: NoiseModel
    """Of the plant's points."""
    amplitude: Amplitude | None
    weights: Weights
    relative: float = 0.0
    """Relative model error that the weights allow for beside the noise."""
    reach: float = FAR
    """That of `amplitude_of`."""


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


def noise_of(model: PlaneModel, points: PlanePoints, amplitude: Amplitude | None) -> NoiseModel:
    """Noise of the residuals under a model, with what is not known of transients that were taken out."""
    i, y = predicted_blocks(model, points, amplitude)
    size = y if points.I is None else np.concatenate([i, y], axis=2)
    noise = block_noise(
        residual_blocks(points, i, y),
        points.omega,
        magnitude=np.abs(size.mean(axis=1)),
        suspect=points.suspect,
        sparse=points.many is not None,
    )
    return noise if points.unsettled is None else replace(noise, covariance=noise.covariance + points.unsettled)


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
    plant = np.linalg.inv(np.linalg.cholesky(covariance))
    amplifier = None
    if data.amplifier is not None and data.amplifier.I is not None:
        i = model.amplifier_response(data.amplifier.omega, base_band=False)[:, None, :] * data.amplifier.U
        amplifier = block_noise(data.amplifier.I - i, data.amplifier.omega).whitener()
    return Weights(np.asarray(plant), amplifier), noise


def residuals(
    model: PlaneModel, data: Data, weights: Weights, amplitude: Amplitude | None, gradient: bool = True
) -> tuple[Real, Real | None]:
    """Whitened residuals of the means, unit variance each, and their Jacobian.

    Returns
    -------
    residual, jacobian
        (N,) and (N, size): plant's points first, real parts then imaginary ones; what the datasheet says last.
    """
    points = data.plant
    p = model.predict(Points(points.omega, points.u), amplitude, gradient)
    has_i = points.I is not None
    e = np.concatenate([points.i - p.i, points.y - p.y], axis=1) if points.i is not None else points.y - p.y
    rows = [_stacked(np.einsum("pab,pb->pa", weights.plant, e))]
    jacobians = []
    if gradient:
        assert p.d_i is not None
        assert p.d_y is not None
        d = np.concatenate([p.d_i, p.d_y], axis=1) if has_i else p.d_y
        jacobians.append(-_stacked(weights.plant @ d))
    if weights.amplifier is not None and data.amplifier is not None and data.amplifier.i is not None:
        e, d_e = _amplifier_residual(model, data.amplifier, gradient)
        rows.append(_stacked(np.einsum("pab,pb->pa", weights.amplifier, e)))
        if gradient:
            jacobians.append(-_stacked(weights.amplifier @ d_e))
    if data.prior is not None:
        e_prior, d_prior = data.prior.rows(model)
        rows.append(e_prior)
        jacobians.append(d_prior)
    return np.concatenate(rows), np.concatenate(jacobians) if gradient else None


def _stacked(values: Complex) -> Real:
    """Real then imaginary parts as rows, unit variance for a unit complex variance."""
    flat = values.reshape(-1, *values.shape[2:])
    return np.asarray(np.sqrt(2.0) * np.concatenate([flat.real, flat.imag]))


def _amplifier_residual(model: PlaneModel, points: PlanePoints, gradient: bool) -> tuple[Complex, Complex]:
    from service.identification import amplifier as amp

    assert points.i is not None
    delay = model.delay_s + model.known.computing_delay_s
    i = np.empty_like(points.u)
    d = np.zeros((*points.u.shape, model.layout.size if gradient else 0), dtype=complex)
    for j, place in enumerate(model.layout.amplifiers):
        response, slope = amp.sampled(points.omega, model.theta[place], delay, model.known.sample_time_s)
        i[:, j] = response * points.u[:, j]
        if gradient:
            d[:, j, place] = slope[:, :-1] * points.u[:, j, None]
            d[:, j, model.layout.delay] = slope[:, -1] * points.u[:, j]
    return points.i - i, d


def amplitude_of(model: PlaneModel, at: PlanePoints | Points, reach: float = FAR, rounds: int = 3) -> Amplitude:
    """Amplitudes at the bearings that the model sees at the measured u, the force law's excess included.

    Parameters
    ----------
    reach
        No bearing is taken to move further than so many times what the sensors see: a shape whose split is not known
        yet would put it anywhere, and the excess, cubic, with it.
    """
    points = Points(at.omega, at.u)
    many, together = (at.many, at.together) if isinstance(at, PlanePoints) else (None, None)
    limit = reach * np.linalg.norm(at.y, axis=1, keepdims=True) if isinstance(at, PlanePoints) else np.inf

    def now(p: Prediction) -> Amplitude:
        x = p.x * np.minimum(1.0, limit / np.maximum(np.abs(p.x), 1e-30))
        return Amplitude(p.coil, x, together, None if many is None else many.products(p.coil, x))

    p = model.predict(points)
    for _ in range(rounds):
        p = model.predict(points, now(p))
    return now(p)


def refine(
    model: PlaneModel,
    data: Data,
    free: NDArray[np.bool_],
    *,
    relative: float = 0.0,
    nonlinear: bool = True,
    split: Split | Knowledge | None = None,
    weights: Weights | None = None,
    max_iterations: int = 60,
    reach: float = FAR,
) -> Refined:
    """Model that is most likely under the measured noise.

    Parameters
    ----------
    model, data, free
        Start, measured points, and which parameters may move.
    relative
        See `weights_of`.
    nonlinear
        Whether the force law's excess at the measured amplitudes is taken into account.
    split
        Where to hold the modes' splits, which the data hardly tell, or what is known of them.
    weights
        Whitening to use; by default that of the start, and once more that of the outcome.
    reach
        See `amplitude_of`.
    """
    rounds = (2 if nonlinear else 1) if relative or weights is not None else (3 if nonlinear else 2)
    fit: Fit | None = None
    amplitude: Amplitude | None = None
    now = weights
    noise: NoiseModel | None = None
    for _ in range(rounds):
        if nonlinear:
            amplitude = amplitude_of(model, data.plant, reach)
        if weights is None:
            now, noise = weights_of(model, data, amplitude, relative)
        assert now is not None
        fit = _minimise(model, data, now, amplitude, free, split, max_iterations)
        model = model.at(fit.theta)
    if noise is None:
        noise = noise_of(model, data.plant, amplitude)
    assert fit is not None
    assert now is not None
    return Refined(model, fit, noise, amplitude, now, relative, reach)


def _minimise(
    model: PlaneModel,
    data: Data,
    weights: Weights,
    amplitude: Amplitude | None,
    free: NDArray[np.bool_],
    split: Split | Knowledge | None,
    max_iterations: int,
) -> Fit:
    def residual(theta: Real, gradient: bool) -> tuple[Real, Real | None] | None:
        trial = model.at(theta)
        if not trial.is_physical:
            return None
        r, j = residuals(trial, data, weights, amplitude, gradient)
        if split is not None and trial.layout.n_modes:
            more, slope = held_rows(trial, split)
            r = np.concatenate([r, more])
            j = None if j is None else np.concatenate([j, slope])
        return r, j

    return minimise(residual, model.theta, free, max_iterations)
