"""How a mode's shape splits between bearings and sensors: what the data cannot tell, and what is known besides.

u, i and y fix the product of a mode's shapes at sensors and bearings. Scaling phi_b by sqrt(a) and phi_s by 1/sqrt(a)
changes nothing but the work of the position stiffness on the flexible displacement at the bearings: the effective
stiffness of each magnet by a few parts in a thousand, the mode's frequency by less; by parts in a hundred on a heavy
flexible rotor. Where the data do not tell, other knowledge must. That is either the rotor model of the datasheet, where
it has the mode, or that bearing and sensor sit close together: from one to the other a shape changes little beside its
largest value, but where it is steep. The change at each bearing then has a Student prior, whose tails forgive the steep
end; towards the shaft's end a shape rather grows than falls. And shapes at bearings and sensors are of one order.

This knowledge is part of every joint fit, as residuals beside those of the data. The last fit holds the splits where
that put them; their distribution about it (`split_posterior`) is carried into every figure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.plane.layout import N_MODE
from service.identification.plane.model import PlaneModel
from service.identification.priors.beyond import BEYOND_ROWS, beyond_rows

HELD = 1e-3
"""Standard deviation of a held split's logarithm: nothing beside what is not known of it."""
TAILS = 3.0
"""Degrees of freedom of the Student prior."""
UNLIKELY_FALL = 0.5
"""Of the scale, for a change of the first mode that goes against the growth towards the shaft's end."""
BEYOND = 0.8
"""Standard deviation of ln(|phi_s|/|phi_b|) of a mode beyond the band, 1 within: it stands for many, which even out."""
ROWS = 3
"""Residuals of knowledge per mode: of the order of its split, and of its change at either bearing."""
LIKELY = np.linspace(-2.0, 2.0, 81)
"""Splits among which the likeliest is looked for where a fit begins."""


@dataclass(frozen=True)
class Knowledge:
    """What is known of splits besides the data."""

    closeness: float | None
    """Scale of the first mode's change from bearing to sensor beside its largest value; shapes of higher modes are
    steeper. None: nothing is assumed but that shapes are of one order."""
    outboard: tuple[bool, bool]
    """Whether the sensor lies outside the bearing, at A and B."""
    frequencies: Real
    """(k,) rad/s, modes of the datasheet; ``log_ratios`` their ln(|phi_s|/|phi_b|), and the standard deviation."""
    log_ratios: Real
    std: float
    end_rad_s: float = np.inf
    """Of the band that was measured."""

    def order_of(self, model: PlaneModel) -> Real:
        """Standard deviation of ln(|phi_s|/|phi_b|) where nothing else is known, (n,)."""
        return np.where(model.modes[:, 0] > self.end_rad_s, BEYOND, 1.0)

    def scales_of(self, place: int) -> tuple[float, float]:
        """Scales of a mode's growth towards the shaft's end and of its fall; ``place`` is by rising frequency, from 0.

        The end slope of the k-th mode of a free uniform beam is (2 k + 1) pi/2 per length, k from 1, and the nearer its
        nodes lie to the bearings the smaller is the shape that it is counted in: about k times the first one's.
        Only of the first one is it unlikely that a bearing lies within the outermost node, where a shape falls.
        """
        assert self.closeness is not None
        scale = self.closeness * (place + 1)
        return scale, scale * (UNLIKELY_FALL if place == 0 else 1.0)

    def of_modes(self, model: PlaneModel) -> Real:
        """ln(|phi_s|/|phi_b|) of each mode by the datasheet's mode near to it, nan without one, (n,)."""
        out = np.full(model.layout.n_modes, np.nan)
        if not len(self.frequencies):
            return out
        for k, w in enumerate(model.natural_frequencies):
            near = int(np.argmin(np.abs(self.frequencies - w)))
            if abs(self.frequencies[near] - w) < 0.05 * w:
                out[k] = self.log_ratios[near]
        return out


@dataclass(frozen=True)
class Split:
    """Splits as a fit takes them: ln(|phi_s|/|phi_b|) of each mode, and how firmly they are held."""

    log_ratios: Real
    """(n,)"""
    std: float = HELD
    beyond: NDArray[np.bool_] | None = None
    """(n,) modes beyond the band, of which something is known too (`beyond`)."""

    @classmethod
    def of(cls, model: PlaneModel, end_rad_s: float) -> Split:
        """Those of a model, measured up to ``end_rad_s``."""
        return cls(log_ratios(model), beyond=model.modes[:, 0] > end_rad_s)


def log_ratios(model: PlaneModel) -> Real:
    """ln(|phi_s|/|phi_b|) of each mode, (n,)."""
    bearing, sensor = np.sqrt(_squares(model)) + 1e-12
    return np.asarray(np.log(sensor / bearing))


def _squares(model: PlaneModel) -> Real:
    """|phi_b|^2 and |phi_s|^2 of each mode, (2, n)."""
    shapes = model.modes[:, 2:6].reshape(-1, 2, 2)
    return np.asarray(np.einsum("nja,nja->jn", shapes, shapes))


def split_rows(model: PlaneModel, split: Split) -> tuple[Real, Real]:
    """Residuals that hold the splits, one per mode, and their Jacobian."""
    rows = (log_ratios(model) - split.log_ratios) / split.std
    jacobian = np.zeros((len(rows), model.layout.size))
    per_shape = np.array([[-1.0], [1.0]]) / np.maximum(_squares(model), 1e-24) / split.std
    places = _shape_places(model)
    jacobian[np.arange(len(rows))[:, None], places] = model.modes[:, 2:6] * np.repeat(per_shape.T, 2, axis=1)
    return rows, jacobian


def _shape_places(model: PlaneModel) -> NDArray[np.int64]:
    """Places of each mode's shapes at bearings and sensors among the parameters, (n, 4)."""
    layout = model.layout
    return layout.delay + 3 + N_MODE * np.arange(layout.n_modes)[:, None] + np.arange(4)


def moved_along_splits(model: PlaneModel, step: Real) -> Real:
    """A model's parameters after a step, in which splits change as they do: by factors.

    The data tell the product of a mode's shapes to parts in a million; a straight step that makes one larger and the
    other smaller keeps it to first order only, and so could be no longer than parts in a thousand.
    """
    change = split_rows(model, Split(np.zeros(model.layout.n_modes), 1.0))[1] @ step
    theta = model.theta + step
    for k, ln in enumerate(change):
        at = model.layout.mode(k).start
        for place, sign in ((slice(at + 2, at + 4), -0.5), (slice(at + 4, at + 6), 0.5)):
            theta[place] += model.theta[place] * (np.expm1(sign * ln) - sign * ln)
    return np.asarray(theta)


@dataclass(frozen=True)
class Posterior:
    """Where a fit holds ln(|phi_s|/|phi_b|) of each mode, and second moments of the relative change of a about that."""

    log_ratios: Real
    covariance: Real
    shapes: Real | None = None
    """(n, 2) second moments of the relative changes of phi_b and of phi_s, a^(1/2) - 1 and a^(-1/2) - 1. They are half
    those of a while that is small, but the smaller side of a shape may be the larger one, which no change of a tells.
    None: as half those of a."""


def held_rows(model: PlaneModel, held: Split | Knowledge) -> tuple[Real, Real]:
    """Residuals of splits that are held or known of, beside those of the data.

    Parameters
    ----------
    model
        With n modes and ``size`` parameters.
    held
        Where the splits are held, or what is known of them.

    Returns
    -------
    rows : (K,), in standard deviations of what is known
        Of modes beyond the band (`beyond_rows`), then those of splits: one a mode for `Split`, `ROWS` for `Knowledge`.
        Of `Knowledge` modes within the band have zeros in place of the former, so that K stays while modes move.
    jacobian : (K, size), of the rows per unit of each parameter
    """
    if isinstance(held, Split):
        rows, jacobian = split_rows(model, held)
        if held.beyond is None:
            return rows, jacobian
        more, slope = beyond_rows(model, held.beyond)
    else:
        rows, jacobian = knowledge_rows(model, held)
        beyond = model.modes[:, 0] > held.end_rad_s
        there = np.repeat(beyond, BEYOND_ROWS)
        more, slope = np.zeros(len(there)), np.zeros((len(there), model.layout.size))
        if beyond.any():
            more[there], slope[there] = beyond_rows(model, beyond, counting=True)
    return np.concatenate([more, rows]), np.vstack([slope, jacobian])


def knowledge_rows(model: PlaneModel, knowledge: Knowledge) -> tuple[Real, Real]:
    """Residuals whose squares are twice the negative log density of what is known, `ROWS` a mode, and their slope."""
    known = knowledge.of_modes(model)
    ratios, order = split_rows(model, Split(np.zeros(len(known)), 1.0))
    rows, jacobian = np.zeros((len(known), ROWS)), np.zeros((len(known), ROWS, model.layout.size))
    open_ = np.isnan(known)
    spread = np.where(open_, knowledge.order_of(model), knowledge.std)
    rows[:, 0] = (ratios - np.where(open_, 0.0, known)) / spread
    jacobian[:, 0] = order / spread[:, None]
    if knowledge.closeness is not None and open_.any():
        at = np.flatnonzero(open_)
        shapes, scales = model.modes[at, 2:6], _scales(model, knowledge)[at]
        rows[at, 1:], slope = _growth_rows(shapes[:, :2], shapes[:, 2:], scales, knowledge)
        jacobian[at[:, None, None], [[1], [2]], _shape_places(model)[at][:, None]] = slope
    return rows.ravel(), jacobian.reshape(-1, model.layout.size)


def _growth_rows(bearing: Real, sensor: Real, scales: Real, knowledge: Knowledge) -> tuple[Real, Real]:
    """Residuals of n modes' change at either bearing, (n, 2), and their slope to (b_A, b_B, s_A, s_B), (n, 2, 4)."""
    shape, modes = np.concatenate([bearing, sensor], axis=1), np.arange(len(bearing))
    top = np.argmax(np.abs(shape), axis=1)
    largest = shape[modes, top][:, None]
    size = np.abs(largest) + 1e-12
    sign = np.where(bearing < 0, -1.0, 1.0)
    change = (sensor - bearing) * sign
    steep = 1.0 / size / _scale(change / size, scales, knowledge)
    growth = change * steep
    slope = np.zeros((len(bearing), 2, 4))
    for j in range(2):
        slope[:, j, j], slope[:, j, 2 + j] = -sign[:, j] * steep[:, j], sign[:, j] * steep[:, j]
        slope[modes, j, top] -= (growth * np.sign(largest) / size)[:, j]
    rows = np.sign(growth) * np.sqrt((TAILS + 1) * np.log1p(growth**2 / TAILS))
    near = np.abs(growth) < 1e-6
    by_growth = np.where(
        near, np.sqrt((TAILS + 1) / TAILS), (TAILS + 1) * growth / (TAILS + growth**2) / np.where(near, 1.0, rows)
    )
    return rows, by_growth[..., None] * slope


def _scales(model: PlaneModel, knowledge: Knowledge) -> Real:
    """`Knowledge.scales_of` each mode, in the model's order, (n, 2)."""
    if knowledge.closeness is None:
        return np.zeros((model.layout.n_modes, 2))
    place = np.argsort(np.argsort(model.natural_frequencies))
    return np.array([knowledge.scales_of(int(k)) for k in place]).reshape(-1, 2)


def _scale(growth: Real, scales: Real, knowledge: Knowledge) -> Real:
    """Scale of a change at bearings A and B, (..., 2): that of growth towards the shaft's end, or of fall."""
    outboard = np.array(knowledge.outboard)
    falls = outboard & (growth < 0) | ~outboard & (growth > 0)
    return np.where(falls, scales[..., 1:], scales[..., :1])


def log_prior(model: PlaneModel, points: Real, knowledge: Knowledge) -> Real:
    """Log density of splits ln(|phi_s|/|phi_b|), (N, n), of the modes' shapes by knowledge alone, mode by mode, (N, n).

    Up to a constant.
    """
    here, known = log_ratios(model), knowledge.of_modes(model)
    scales, spread = _scales(model, knowledge), knowledge.order_of(model)
    out = np.zeros_like(points)
    for k, mode in enumerate(model.modes):
        if not np.isnan(known[k]):
            out[:, k] = -0.5 * ((points[:, k] - known[k]) / knowledge.std) ** 2
            continue
        out[:, k] = -0.5 * (points[:, k] / spread[k]) ** 2
        if knowledge.closeness is None:
            continue
        half = np.exp(0.5 * (points[:, k] - here[k]))[:, None]
        bearing, sensor = mode[2:4] / half, mode[4:6] * half
        largest = np.maximum(np.abs(sensor).max(axis=1), np.abs(bearing).max(axis=1))[:, None] + 1e-12
        growth = (sensor - bearing) * np.where(bearing < 0, -1.0, 1.0) / largest
        growth = growth / _scale(growth, scales[k], knowledge)
        out[:, k] -= 0.5 * (TAILS + 1) * np.sum(np.log1p(growth**2 / TAILS), axis=1)
    return out


def likeliest(model: PlaneModel, knowledge: Knowledge) -> Real:
    """ln(|phi_s|/|phi_b|) of each mode that knowledge alone holds for likeliest, (n,)."""
    known = knowledge.of_modes(model)
    grid = np.repeat(LIKELY[:, None], model.layout.n_modes, axis=1)
    best = LIKELY[np.argmax(log_prior(model, grid, knowledge), axis=0)] if len(known) else known
    return np.where(np.isnan(known), best, known)
