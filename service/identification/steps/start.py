"""Where the joint fit starts: a plane with the modes that the measured plant's poles and residues tell of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.measured.etfe import FrequencyResponse
from service.identification.measured.points import PlanePoints
from service.identification.plane.layout import MODE_NAMES, N_MODE, Layout
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import log_ratios
from service.identification.steps.flexible import PoleResidue, has_peak, is_visible, search, shapes_of
from service.identification.steps.rational import LEVEL, Rational, rational_fit
from service.identification.steps.rigid import levitated, rigid_refined, rigid_response

NEAREST, FURTHEST, USUAL = 1.5, 4.0, 2.0
"""Where modes beyond the band are started, in units of its end; the last where the remainder does not tell."""
BEYOND_DAMPING, MOST_DAMPED = 0.005, 0.5
SEARCHED_MODES, SEARCHED_ENOUGH, SEARCHED_FLOOR = 5, 0.005, 0.03
"""Modes looked for in what a rigid model leaves, the relative misfit at which that stops, and the one below which a
further mode explains nothing that the joint fit would not."""


def with_modes(model: PlaneModel, modes: Real) -> PlaneModel:
    """The same plane with other modes, (n, 6) in the order of `MODE_NAMES`, ascending."""
    modes = np.asarray(modes, dtype=float).reshape(-1, N_MODE)
    modes = modes[np.argsort(modes[:, 0])]
    layout = Layout(model.layout.amplifier_orders, len(modes))
    start = model.layout.delay + 1
    theta = np.concatenate([model.theta[:start], modes.ravel(), model.theta[model.layout.given]])
    return replace(model, layout=layout, theta=theta)


def with_split(model: PlaneModel, ratios: Real) -> PlaneModel:
    """The same plane with each mode's shape split as told, ln(|phi_s|/|phi_b|)."""
    modes = model.modes.copy()
    factor = np.exp(0.5 * (ratios - log_ratios(model)))[:, None]
    modes[:, 2:4] /= factor
    modes[:, 4:6] *= factor
    return with_modes(model, modes)


def modes_from(found: PoleResidue, ki: Real) -> Real:
    """Start of the modes' parameters from a pole-residue model of the plant, (n, 6)."""
    rows = []
    for nu, sigma, residue in zip(found.nu_rad_s, found.sigma_rad_s, found.residues, strict=True):
        bearing, sensor = shapes_of(residue, ki)
        rows.append([nu, min(sigma, MOST_DAMPED * nu), *bearing, *sensor])
    return np.array(rows).reshape(-1, len(MODE_NAMES))


def joint_start(
    rigid_model: PlaneModel, rational: Rational, points: PlanePoints, plant: FrequencyResponse
) -> PlaneModel:
    """A plane whose ki and ks are those of the rigid part alone, with modes of the peaks and of what lies beyond.

    Parameters
    ----------
    rigid_model
        Amplifiers fitted, no modes, ki and ks of the staged fit.
    """
    omega = points.omega
    current = rigid_model.amplifier_response(omega) * points.u
    rest = points.y - np.einsum("pab,pb->pa", rational.flexible_response(omega), current)
    size = np.broadcast_to(np.linalg.norm(points.y, axis=1, keepdims=True), points.y.shape)
    ki, ks = rigid_refined(rigid_model, rigid_model.ki, rigid_model.ks, omega, current, rest, np.asarray(size))
    theta = rigid_model.theta.copy()
    theta[0:2], theta[2:4] = ki, ks
    modes = np.vstack([modes_from(rational.peaks, ki), _beyond(rational, plant, ki)])
    return with_modes(rigid_model.at(theta), modes)


def sharp_start(
    rigid_model: PlaneModel, points: PlanePoints, plant: FrequencyResponse, lowest_rad_s: float
) -> PlaneModel | None:
    """A plane as `joint_start` makes it, also with peaks that the lines around them are too far apart to show.

    None where there is no such peak: `joint_start` has all of them.
    """
    rational = rational_fit(plant, levitated(rigid_model, rigid_model.ks), lowest_rad_s, sharp=True)
    poles = zip(rational.peaks.nu_rad_s, rational.peaks.sigma_rad_s, strict=True)
    if all(is_visible(nu, sigma, plant.omega) or not has_peak(nu, sigma, plant.omega) for nu, sigma in poles):
        return None
    return joint_start(rigid_model, rational, points, plant)


def searched_starts(rigid_model: PlaneModel, plant: FrequencyResponse, lowest_rad_s: float) -> list[PlaneModel]:
    """Planes with the modes that are found in what the staged rigid model leaves, the most likely number first.

    On a dozen lines this tells of more than the poles and residues of the whole plant do: the rigid rotor is known from
    four numbers, where they take twenty.
    """
    left = plant.value - rigid_response(rigid_model, rigid_model.ki, rigid_model.ks, plant.omega)
    size = np.linalg.norm(plant.value, axis=(1, 2))[:, None, None]
    weight = np.broadcast_to(1 / size, left.shape).copy()
    models = search(plant.omega, left, weight, SEARCHED_MODES, lowest_rad_s, enough=SEARCHED_ENOUGH)
    n, level = 2 * left.size, 4 * len(plant.omega) * SEARCHED_FLOOR**2
    cost = [np.sum(np.abs((left - m.response(plant.omega)) * weight) ** 2) for m in models]
    length = [n * np.log(c + level) + 10 * (k + 1) * np.log(n) for k, c in enumerate(cost)]
    likely = models[: int(np.argmin(length)) + 1] if models else []
    begin = [modes_from(m, rigid_model.ki) for m in reversed(likely)]
    seen = [m[[is_visible(mode[0], mode[1], plant.omega) for mode in m]] for m in begin[:1]]
    return [with_modes(rigid_model, modes) for modes in (*seen, *begin[1:])]


def _beyond(rational: Rational, plant: FrequencyResponse, ki: Real) -> Real:
    """Modes beyond the band without which the model would be off by more than its level, (n, 6) with n up to 2."""
    weight = 1.0 / np.sqrt(np.mean(plant.std**2 + (LEVEL * np.abs(plant.value)) ** 2, axis=(1, 2)))
    modes = remote_modes(rational.remainder[0], -rational.remainder[2], float(plant.omega.max()), ki)
    off = [np.linalg.norm(np.outer(m[4:6], m[2:4] * ki)) / 2 / m[0] ** 2 * weight for m in modes]
    return modes[[bool(np.mean(o**2) > 1.0) for o in off]].reshape(-1, N_MODE)


def remote_modes(still: Real, bend: Real, end_rad_s: float, ki: Real) -> Real:
    """Two modes beyond the band from what they leave within it, the sum of R/nu^2 + R w^2/nu^4, (2, 6).

    Parameters
    ----------
    still, bend
        (2, 2) of the plant, at rest and per w^2.
    end_rad_s
        Of the band.
    """
    left, singular, right = np.linalg.svd(still / ki)
    rows = []
    for u, size, v in zip(left.T, singular, right, strict=True):
        curvature = float(u @ (bend / ki) @ v)
        nu = np.sqrt(size / curvature) if curvature > 0 else USUAL * end_rad_s
        nu = float(np.clip(nu, NEAREST * end_rad_s, FURTHEST * end_rad_s))
        bearing, sensor = shapes_of(nu**2 * size * np.outer(u, v), np.ones(2))
        rows.append([nu, BEYOND_DAMPING * nu, *bearing, *sensor])
    return np.array(rows)


def remote(plant: FrequencyResponse, left: Complex, ki: Real) -> Real:
    """The one mode beyond the band that what is left of a plant, (F, 2, 2), calls loudest for, (1, 6)."""
    weight = 1.0 / np.sqrt(np.mean(plant.std**2, axis=(1, 2)))
    end = float(plant.omega.max())
    columns = np.stack([np.ones_like(plant.omega), (plant.omega / end) ** 2], axis=1) * weight[:, None]
    still, bend = np.linalg.lstsq(columns, (left.real * weight[:, None, None]).reshape(-1, 4), rcond=None)[0]
    return remote_modes(still.reshape(2, 2), bend.reshape(2, 2) / end**2, end, ki)[:1]
