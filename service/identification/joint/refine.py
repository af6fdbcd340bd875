"""Joint refinement of a plane: everything at once, in units of the measured noise.

The most likely model, found in rounds: amplitudes at the bearings and weights are those of the model before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real
from service.identification.joint.residuals import Weights, noise_of, residuals, weights_of
from service.identification.measured.data import Data
from service.identification.measured.noise import NoiseModel
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Amplitude, Points
from service.identification.priors.split import Knowledge, Split, held_rows, moved_along_splits, split_rows
from service.identification.statistics.least_squares import Fit, minimise

NEAR, FAR = 1.5, 10.0
"""Displacement of a bearing over that of the sensors, at most: while modes are counted, and in the end."""
TOLERANCE, NEARLY = 1e-4, 1e-2
"""Fall of the cost below which no step is worth it: in the last round, and in those whose weights and amplitudes are
made anew after them."""
FAR_OFF, NEAR_BY = 1e-3, 1e-7
"""Damping of the first step: from a start, and from where a round before has led."""

SPLIT_STEP = 1e-3
"""Of ln(|phi_s|/|phi_b|), for the slope of the amplitudes at the bearings."""


@dataclass(frozen=True)
class Refined:
    """A refined plane."""

    model: PlaneModel
    fit: Fit
    points: PlanePoints
    amplitude: Amplitude | None
    weights: Weights
    relative: float = 0.0
    """Relative model error that the weights allow for beside the noise."""
    reach: float = FAR
    """That of `amplitude_of`."""
    told_noise: NoiseModel | None = None
    """That of the points under another model, where it shall stand."""

    @cached_property
    def noise(self) -> NoiseModel:
        """Of the points, under the model with which the weights were made, or under this one where they were given."""
        return self.told_noise or noise_of(self.model, self.points, self.amplitude)


def amplitude_of(model: PlaneModel, at: PlanePoints | Points, reach: float = FAR, rounds: int = 3) -> Amplitude:
    """Amplitudes at the bearings that the model sees at the measured u, the force law's excess included.

    Parameters
    ----------
    reach
        No bearing is taken to move further than so many times what the sensors see: a shape whose split is not known
        yet would put it anywhere, and the excess, cubic, with it.
    """
    motion = model.motion(at.at if isinstance(at, PlanePoints) else at)
    for _ in range(rounds):
        motion = motion.about(_amplitude(at, motion.coil, motion.x, reach))
    return _amplitude(at, motion.coil, motion.x, reach)


def _amplitude(at: PlanePoints | Points, coil: Complex, x: Complex, reach: float) -> Amplitude:
    """Of coil currents and displacements at the bearings, (2, P) each."""
    many, together, limit = None, None, np.inf
    if isinstance(at, PlanePoints):
        many, together, limit = at.many, at.together, reach * np.linalg.norm(at.y, axis=1)
    within = (x * np.minimum(1.0, limit / np.maximum(np.abs(x), 1e-30))).T
    return Amplitude(coil.T, within, together, None if many is None else many.products(coil.T, within))


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
    following: bool = False,
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
    following
        Whether amplitudes at the bearings, and the excess with them, follow the splits while the model is sought
        (`residuals_following`); otherwise they are those of the round's start.
    """
    rounds = (2 if nonlinear and not following else 1) if relative or weights is not None else (3 if nonlinear else 2)
    along = reach if following and nonlinear else None
    fit: Fit | None = None
    amplitude: Amplitude | None = None
    now = weights
    noise: NoiseModel | None = None
    for k in range(rounds):
        if nonlinear:
            amplitude = amplitude_of(model, data.plant, reach)
        if weights is None:
            now, noise = weights_of(model, data, amplitude, relative)
        assert now is not None
        far_off = k == 0 and along is None
        fit = _minimise(model, data, now, amplitude, free, split, max_iterations, far_off, k == rounds - 1, along)
        model = model.at(fit.theta)
    assert fit is not None
    assert now is not None
    if along is not None:
        amplitude = amplitude_of(model, data.plant, reach)
    return Refined(model, fit, data.plant, amplitude, now, relative, reach, noise)


def _minimise(
    model: PlaneModel,
    data: Data,
    weights: Weights,
    amplitude: Amplitude | None,
    free: NDArray[np.bool_],
    split: Split | Knowledge | None,
    max_iterations: int,
    first: bool,
    last: bool,
    following_to: float | None,
) -> Fit:
    def residual(theta: Real, gradient: bool) -> tuple[Real, Real | None] | None:
        trial = model.at(theta)
        if not trial.is_physical:
            return None
        if following_to is None:
            r, j = residuals(trial, data, weights, amplitude, gradient, free)
        else:
            r, j = residuals_following(trial, data, weights, free, following_to, gradient)
        if split is not None and trial.layout.n_modes:
            more, slope = held_rows(trial, split)
            r = np.concatenate([r, more])
            j = None if j is None else np.concatenate([j.T, slope.T[free]], axis=1).T
        return r, j

    tolerance, damping = TOLERANCE if last else NEARLY, FAR_OFF if first else NEAR_BY

    def physical(theta: Real) -> bool:
        return model.at(theta).is_physical

    def moved(theta: Real, step: Real) -> Real:
        return moved_along_splits(model.at(theta), step)

    way = None if following_to is None else moved
    fit = minimise(residual, model.theta, free, max_iterations, tolerance, damping, physical, way)
    order = _line_after_line(data, len(fit.residual))
    return replace(fit, residual=fit.residual[order], jacobian=fit.jacobian[order])


def residuals_following(
    model: PlaneModel, data: Data, weights: Weights, free: NDArray[np.bool_], reach: float, gradient: bool = True
) -> tuple[Real, Real | None]:
    """Residuals at the amplitudes that the model itself sees at the bearings, and their slope with those following.

    What the sensors see tells how far the bearings move but for each mode's split: a mode's part of the motion there is
    in proportion to (|phi_b|/|phi_s|), and the excess goes with the cube of the motion. So a loud line tells of splits,
    those of modes within the band.

    Returns
    -------
    residual, jacobian
        As of `residuals`.
    """
    points = data.plant
    amplitude = amplitude_of(model, points, reach)
    r, j = residuals(model, data, weights, amplitude, gradient, free)
    if j is None or not model.layout.n_modes:
        return r, j
    motion = model.motion(points.at, amplitude)
    parts, ratios = motion.x_of_modes, split_rows(model, Split(np.zeros(model.layout.n_modes), 1.0))[1]
    for k in np.flatnonzero(model.modes[:, 0] <= points.omega.max()):
        beside = _amplitude(points, motion.coil, motion.x - SPLIT_STEP * parts[k], reach)
        slope = (residuals(model, data, weights, beside, gradient=False)[0] - r) / SPLIT_STEP
        j = j + np.outer(slope, ratios[k, free])
    return r, j


def _line_after_line(data: Data, n: int) -> NDArray[np.int64]:
    """Order of n rows of `residuals` in which neighbouring lines are neighbours: their model errors go together.

    Real parts of a set's points, all channels of each, then the imaginary ones.
    """
    order, start = [], 0
    channels = 2 if data.plant.I is None else 4
    sets = [(channels, data.plant)] + ([] if data.amplifier is None else [(2, data.amplifier)])
    for c, points in sets:
        if points is data.amplifier and points.I is None:
            continue
        size = 2 * c * len(points.omega)
        order.append(start + np.arange(size).reshape(c, -1, 2).transpose(2, 1, 0).ravel())
        start += size
    return np.concatenate([*order, np.arange(start, n)])
