"""Joint maximum likelihood of the rotating model over all speeds, in units of the measured noise.

Residuals are those of the planes' joint fit, for all axes at once; see `joint.refine`. Each speed has a noise of its
own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real
from service.identification.measured.noise import NoiseModel, block_noise
from service.identification.plane.prediction import Amplitude
from service.identification.priors.beyond import beyond_rows
from service.identification.priors.split import Split, split_rows
from service.identification.rotating.model import RotatingModel
from service.identification.rotating.motion import TurningPoints
from service.identification.rotating.points import SpeedPoints
from service.identification.statistics.least_squares import Fit, minimise

SCAN_STEPS = 161
"""Most couplings that a search for a start tries."""
POLAR_STEPS, POLAR_WITHIN = 401, 2.0
"""Polar inertias that it tries, to either side of none, up to so many transverse inertias: a speed that is told with
the wrong sign makes it negative."""
POLAR_CLOSER, POLAR_BESIDE = 81, 0.02
"""The same about one that a slower speed gave: tries, and how far to either side, in transverse inertias."""


@dataclass(frozen=True)
class RotatingFit:
    """A fitted rotating model; ``relative`` is zero, as weights hold noise alone."""

    model: RotatingModel
    fit: Fit
    noise: tuple[NoiseModel, ...]
    amplitude: tuple[Amplitude, ...]
    weights: tuple[Complex, ...]
    relative: float = 0.0


def turning(points: SpeedPoints) -> TurningPoints:
    """Where the model is evaluated."""
    return TurningPoints(points.omega, points.speed, points.u)


def noise_of(model: RotatingModel, points: SpeedPoints, amplitude: Amplitude | None) -> NoiseModel:
    """Noise of the residuals under a model: [i, y] of all axes, or y alone."""
    mean = model.predict(turning(points), amplitude)
    away = points.U - points.u[:, None, :]
    y = mean.y[:, None, :] + np.einsum("pyu,pbu->pby", model.response(points.omega, points.speed_rad_s), away)
    if points.I is None:
        return _inflated(
            block_noise(points.Y - y, points.omega, magnitude=np.abs(mean.y), suspect=points.suspect), points
        )
    i = mean.i[:, None, :] + away * model.amplifier_response(points.omega, base_band=False)[:, None, :]
    e = np.concatenate([points.I - i, points.Y - y], axis=2)
    size = np.abs(np.hstack([mean.i, mean.y]))
    return _inflated(block_noise(e, points.omega, magnitude=size, suspect=points.suspect), points)


def _inflated(noise: NoiseModel, points: SpeedPoints) -> NoiseModel:
    """The same with what notching did to each mean, which the scatter of the blocks does not show."""
    if points.inflation is None:
        return noise
    return replace(noise, covariance=noise.covariance * points.inflation[:, None, None])


def weights_of(
    model: RotatingModel, points: SpeedPoints, amplitude: Amplitude | None, relative: float
) -> tuple[Complex, NoiseModel]:
    """Whitening by the measured noise; ``relative`` as in `joint.residuals.weights_of`."""
    noise = noise_of(model, points, amplitude)
    covariance = noise.covariance
    if relative:
        p = model.predict(turning(points), amplitude)
        size, seen = p.y, points.y
        if points.i is not None:
            size, seen = np.hstack([p.i, p.y]), np.hstack([points.i, points.y])
        extra = (relative * np.maximum(np.abs(size), np.abs(seen))) ** 2
        covariance = covariance + extra[:, :, None] * np.eye(extra.shape[1])
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance))), noise


def residuals(
    model: RotatingModel,
    data: tuple[SpeedPoints, ...],
    weights: tuple[Complex, ...],
    amplitude: tuple[Amplitude, ...] | None,
    gradient: bool = True,
) -> tuple[Real, Real | None]:
    """Whitened residuals of the means, speed after speed, and their Jacobian, (N,) and (N, size)."""
    rows, slopes = [], []
    for k, points in enumerate(data):
        p = model.predict(turning(points), None if amplitude is None else amplitude[k], gradient)
        e = points.y - p.y if points.i is None else np.hstack([points.i - p.i, points.y - p.y])
        rows.append(_stacked(np.einsum("pab,pb->pa", weights[k], e)))
        if gradient:
            assert p.d_i is not None
            assert p.d_y is not None
            d = p.d_y if points.i is None else np.concatenate([p.d_i, p.d_y], axis=1)
            slopes.append(-_stacked(weights[k] @ d))
    return np.concatenate(rows), np.concatenate(slopes) if gradient else None


def _stacked(values: Complex) -> Real:
    flat = values.reshape(-1, *values.shape[2:])
    return np.asarray(np.sqrt(2.0) * np.concatenate([flat.real, flat.imag]))


def amplitude_of(model: RotatingModel, points: SpeedPoints, rounds: int = 3) -> Amplitude:
    """Amplitudes at the bearings that the model sees at the measured u, the force law's excess included."""
    at = turning(points)
    p = model.predict(at)
    for _ in range(rounds):
        p = model.predict(at, Amplitude(p.coil, p.x))
    return Amplitude(p.coil, p.x)


def fit_rotating(
    start: RotatingModel,
    data: tuple[SpeedPoints, ...],
    splits: tuple[Split, Split],
    free: NDArray[np.bool_] | None = None,
) -> RotatingFit:
    """Most likely model over all speeds.

    Parameters
    ----------
    start
        Both planes as identified by themselves; couplings are searched for where a speed shows them.
    splits
        Where to hold the shapes' splits of each plane, which the data hardly tell.
    free
        What may move; by default all but mass and sensor gains, and no coupling at standstill.
    """
    free = start.layout.free() if free is None else free
    turns = any(p.speed_rad_s for p in data)
    if not turns:
        free = free.copy()
        free[start.layout.polar :] = False
    if any(p.I is None for p in data):
        free = free & _not_amplifiers(start)
    model = start
    if turns and free[start.layout.polar]:
        slowest, *faster = sorted((p for p in data if p.speed_rad_s), key=lambda p: abs(p.speed_rad_s))
        model = scanned(model, slowest)
        for points in faster:
            model = rescanned(model, points)
        couplings = np.zeros_like(free)
        couplings[start.layout.polar :] = True
        for relative in (0.3, 0.03):
            model = _refined(model, data, splits, couplings, relative, nonlinear=False).model
        model = _refined(model, data, splits, free & _not_amplifiers(start), 0.003, nonlinear=True).model
    return _refined(model, data, splits, free, 0.0, nonlinear=True, rounds=3)


def _not_amplifiers(model: RotatingModel) -> NDArray[np.bool_]:
    return np.array(["amplifier" not in n and not n.endswith("delay_s") for n in model.layout.names])


def _refined(
    model: RotatingModel,
    data: tuple[SpeedPoints, ...],
    splits: tuple[Split, Split],
    free: NDArray[np.bool_],
    relative: float,
    nonlinear: bool,
    rounds: int = 1,
) -> RotatingFit:
    for _ in range(rounds):
        amplitude = tuple(amplitude_of(model, p) for p in data)
        found = [weights_of(model, p, a, relative) for p, a in zip(data, amplitude, strict=True)]
        weights = tuple(w for w, _ in found)
        used = amplitude if nonlinear else None

        def residual(
            theta: Real,
            gradient: bool,
            model: RotatingModel = model,
            weights: tuple[Complex, ...] = weights,
            used: tuple[Amplitude, ...] | None = used,
        ) -> tuple[Real, Real | None] | None:
            trial = model.at(theta)
            if not trial.is_physical:
                return None
            r, j = residuals(trial, data, weights, used, gradient)
            more, slope = held_rows(trial, splits)
            return np.concatenate([r, more]), None if j is None else np.concatenate([j, slope])

        fit = minimise(residual, model.theta, free, 40)
        model = model.at(fit.theta)
    return RotatingFit(model, fit, tuple(n for _, n in found), amplitude, weights, relative)


def held_rows(model: RotatingModel, splits: tuple[Split, Split]) -> tuple[Real, Real]:
    """Residuals of what is known of both planes' modes, beside those of the data.

    Parameters
    ----------
    model
        With ``size`` parameters of both planes and of what couples them.
    splits
        Where the splits of each plane are held, and which of its modes lie beyond the band.

    Returns
    -------
    rows : (K,), in standard deviations of what is known
        Modes beyond the band, of the first plane and of the second (`beyond.beyond_rows`), then those that hold splits,
        one per mode of the first plane and of the second (`priors.split.split_rows`).
    jacobian : (K, size), of the rows per unit of each parameter
    """
    known: list[tuple[Real, Real]] = []
    held: list[tuple[Real, Real]] = []
    for k, split in enumerate(splits):
        plane, own = model.plane(k), model.layout.own[k]
        if not plane.layout.n_modes:
            continue
        beyond = np.zeros(plane.layout.n_modes, dtype=np.bool_) if split.beyond is None else split.beyond
        for rows, (r, j) in ((known, beyond_rows(plane, beyond)), (held, split_rows(plane, split))):
            slope = np.zeros((len(r), model.layout.size))
            slope[:, own] = j[:, : own.stop - own.start]
            rows.append((r, slope))
    whole = [*known, *held, (np.empty(0), np.empty((0, model.layout.size)))]
    return np.concatenate([r for r, _ in whole]), np.concatenate([j for _, j in whole])


def scanned(model: RotatingModel, points: SpeedPoints) -> RotatingModel:
    """The model with the polar inertia and each mode's coupling where the slowest turning sweep wants them, roughly.

    Peaks that gyroscopic coupling splits by more than they are wide leave a local search where it begins, so each
    coupling is tried over its whole range by a misfit that forgives what is far off.
    """
    at, theta = model.layout, model.theta.copy()
    inertia = float(theta[at.rigid][1])
    tries = inertia * np.linspace(-POLAR_WITHIN, POLAR_WITHIN, POLAR_STEPS)
    theta[at.polar] = _best(model, _rigid(model, points), at.polar, tries)
    for k, (a, b) in enumerate(at.pairs):
        modes = model.plane(0).modes[a], model.plane(1).modes[b]
        nu = 0.5 * (modes[0][0] + modes[1][0])
        width = max(min(modes[0][1], modes[1][1]), 1e-4 * nu)
        near = np.abs(points.omega - nu) < 0.15 * nu
        if near.sum() < 8:
            continue
        step = max(2 * width / abs(points.speed_rad_s), 4.0 / SCAN_STEPS)
        tries = step * np.arange(-(SCAN_STEPS // 2), SCAN_STEPS // 2 + 1)
        tries = tries[np.abs(tries) <= 2.0]
        place = at.gyroscopic(k)
        theta[place] = _best(model.at(theta), points.select(near), place, tries)
    return model.at(theta)


def rescanned(model: RotatingModel, points: SpeedPoints) -> RotatingModel:
    """The model with the polar inertia that a faster sweep wants, close to that of a slower one.

    The rotor's nutation is hardly damped without its controller, and its frequency is the polar inertia times the
    speed: the faster, the narrower is the range of inertias from which a local search finds the right one.
    """
    at, theta = model.layout, model.theta.copy()
    beside = float(theta[at.rigid][1]) * POLAR_BESIDE
    tries = theta[at.polar] + beside * np.linspace(-1, 1, POLAR_CLOSER)
    theta[at.polar] = _best(model, _rigid(model, points), at.polar, tries)
    return model.at(theta)


def _rigid(model: RotatingModel, points: SpeedPoints) -> SpeedPoints:
    """Points at which the rotor moves as a rigid body, well below its lowest mode."""
    lowest = min([float(m.modes[:, 0].min()) for m in model.planes if len(m.modes)], default=np.inf)
    return points.select(points.omega < 0.5 * lowest)


def _best(model: RotatingModel, points: SpeedPoints, place: int, values: Real) -> float:
    cost = []
    at = turning(points)
    scale = np.median(np.abs(points.y), axis=0) * 0.1
    for value in values:
        theta = model.theta.copy()
        theta[place] = value
        e = np.abs(points.y - model.at(theta).predict(at).y)
        cost.append(float(np.sum(np.log1p((e / (0.2 * np.abs(points.y) + scale)) ** 2))))
    return float(values[int(np.argmin(cost))])
