"""How a mode's shape splits between bearings and sensors: what the data cannot tell, and what is known besides.

u, i and y fix the product of a mode's shapes at sensors and bearings. Scaling phi_b by sqrt(a) and phi_s by 1/sqrt(a)
changes nothing but the work of the position stiffness on the flexible displacement at the bearings: the effective
stiffness of each magnet by a few parts in a thousand, the mode's frequency by less. For several modes the data hold one
combination of these (the cross term between the bearings); the others need other knowledge. That is either the rotor
model of the datasheet, where it has the mode, or that bearing and sensor sit close together: from one to the other a
shape changes little beside its largest value, but where it is steep. The change at each bearing then has a Student
prior, whose tails forgive the steep end; towards the shaft's end a shape rather grows than falls.

A joint fit holds the splits at given values. Afterwards their distribution is computed, the fit is repeated at its
peak, and its spread about that is carried into every figure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from service.identification.plane_model import PlaneModel
from service.identification.zoh import Real

HELD = 1e-3
"""Standard deviation of a held split's logarithm: nothing beside what is not known of it."""
LOOSE = 0.7
"""The same while modes are searched for: the data may move what they see of a split."""
TAILS = 3.0
"""Degrees of freedom of the Student prior."""
UNLIKELY_FALL = 0.5
"""Of the scale, for a change that goes against the growth towards the shaft's end."""
CENTRES, DRAWS, MAX_ROUNDS, ENOUGH, KERNEL = 150, 3000, 15, 100.0, 0.3
"""Of the importance sampling."""
REACH = 3.0
"""The logarithm of a lies within this of the even split."""


@dataclass(frozen=True)
class Knowledge:
    """What is known of splits besides the data."""

    closeness: float | None
    """Scale of a shape's change from bearing to sensor beside its largest value. None: nothing is
    assumed but that shapes are of one order."""
    outboard: tuple[bool, bool]
    """Whether the sensor lies outside the bearing, at A and B."""
    frequencies: Real
    """(k,) rad/s, modes of the datasheet; ``log_ratios`` their ln(|phi_s|/|phi_b|), and the standard deviation."""
    log_ratios: Real
    std: float

    def of_modes(self, model: PlaneModel) -> Real:
        """ln(|phi_s|/|phi_b|) of each mode by the datasheet's mode near to it, nan without one, (n,)."""
        out = np.full(model.layout.n_modes, np.nan)
        for k, w in enumerate(model.natural_frequencies):
            if len(self.frequencies):
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


def log_ratios(model: PlaneModel) -> Real:
    """ln(|phi_s|/|phi_b|) of each mode, (n,)."""
    m = model.modes
    tiny = 1e-12
    return np.asarray(np.log((np.linalg.norm(m[:, 4:6], axis=1) + tiny) / (np.linalg.norm(m[:, 2:4], axis=1) + tiny)))


def held_at_start(model: PlaneModel, knowledge: Knowledge) -> Split:
    """Splits to begin with: the datasheet's, or even ones."""
    known = knowledge.of_modes(model)
    return Split(np.where(np.isnan(known), 0.0, known), LOOSE)


def split_rows(model: PlaneModel, split: Split) -> tuple[Real, Real]:
    """Residuals that hold the splits, one per mode, and their Jacobian."""
    rows = (log_ratios(model) - split.log_ratios) / split.std
    jacobian = np.zeros((len(rows), model.layout.size))
    for k, mode in enumerate(model.modes):
        at = model.layout.mode(k).start
        bearing, sensor = mode[2:4], mode[4:6]
        jacobian[k, at + 2 : at + 4] = -bearing / max(float(bearing @ bearing), 1e-24) / split.std
        jacobian[k, at + 4 : at + 6] = sensor / max(float(sensor @ sensor), 1e-24) / split.std
    return rows, jacobian


@dataclass(frozen=True)
class Posterior:
    """Most likely ln(|phi_s|/|phi_b|) of each mode, and the second moment of the relative change of a about it."""

    log_ratios: Real
    covariance: Real


def posterior(
    model: PlaneModel, residual: Real, jacobian: Real, free: np.ndarray, knowledge: Knowledge, use_data: bool = True
) -> Posterior:
    """Distribution of the splits, given all that is known.

    Parameters
    ----------
    model
        Joint fit with held splits.
    residual, jacobian
        Of the data alone, whitened, at the fit; columns are the free parameters.
    use_data
        False where the model is known to be wrong: the little that the data say of splits is then swamped.

    The misfit is quadratic in a (the effect is linear in phi_b^2), everything else refitted. Moments by importance
    sampling from a space-filling set, drawn in step by step.
    """
    n = model.layout.n_modes
    here = log_ratios(model)
    slope, curvature = (
        _data_information(model, residual, jacobian, free) if use_data else (np.zeros(n), np.zeros((n, n)))
    )
    known = knowledge.of_modes(model)

    def log_density(points: Real) -> Real:
        """Of ln(|phi_s|/|phi_b|), (N, n)."""
        change = np.exp(np.clip(here - points, -2 * REACH, 2 * REACH)) - 1.0  # a - 1
        data = -0.5 * (2 * change @ slope + np.einsum("pk,kl,pl->p", change, curvature, change))
        return np.asarray(data + _log_prior(model, points, here, known, knowledge))

    centre = np.where(np.isnan(known), 0.0, known)
    points = centre + REACH * (2 * qmc.Sobol(n, seed=0).random_base2(12) - 1)
    proposal = np.zeros(len(points))
    rng = np.random.default_rng(0)
    weight, power, final = np.full(len(points), 1.0 / len(points)), 0.0, 0
    for _ in range(MAX_ROUNDS):
        # a narrow density is approached in steps that each leave enough points of weight
        log_weight = log_density(points)
        power = _largest_power(log_weight, proposal)
        weight = _normalised(power * log_weight - proposal)
        final = final + 1 if power == 1.0 else 0
        if final == 2:
            break
        chosen = points[rng.choice(len(points), size=CENTRES, p=weight)]
        spread = (points - weight @ points).T @ ((points - weight @ points) * weight[:, None])
        kernel = KERNEL**2 * spread + 1e-14 * np.eye(n)
        root = np.linalg.cholesky(kernel)
        points = chosen[rng.integers(CENTRES, size=DRAWS)] + rng.normal(size=(DRAWS, n)) @ root.T
        proposal = _mixture(points, chosen, kernel)
    peak = _peak(points, weight, int(log_density(points).argmax()))
    # everything moves in proportion to a, not to its logarithm: a share that vanishes is a change of one, no more
    away = 1.0 - np.exp(np.clip(peak - points, -2 * REACH, 2 * REACH))
    return Posterior(peak, (away * weight[:, None]).T @ away + 1e-12 * np.eye(n))


def _normalised(log_weight: Real) -> Real:
    weight = np.exp(log_weight - log_weight.max())
    return np.asarray(weight / weight.sum())


def _largest_power(log_density: Real, proposal: Real) -> float:
    """Power of the density, at most 1, at which enough points keep weight."""

    def enough(power: float) -> bool:
        return float(1.0 / np.sum(_normalised(power * log_density - proposal) ** 2)) > ENOUGH

    if enough(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


def _peak(points: Real, weight: Real, best: int) -> Real:
    """Where the weighted points are densest, near the best of them: a mean-shift of shrinking width."""
    at = points[best]
    for width in (0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.1):
        near = 1e-300 + weight * np.exp(-0.5 * np.sum(((points - at) / width) ** 2, axis=1))
        at = near @ points / near.sum()
    return np.asarray(at)


def _mixture(points: Real, centres: Real, kernel: Real) -> Real:
    """Log density of equal Gaussians at the centres, up to a constant, (N,)."""
    root = np.linalg.inv(np.linalg.cholesky(kernel))
    a, b = points @ root.T, centres @ root.T
    square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * a @ b.T
    least = square.min(axis=1)
    return np.asarray(-0.5 * least + np.log(np.sum(np.exp(-0.5 * (square - least[:, None])), axis=1)))


def _log_prior(model: PlaneModel, points: Real, here: Real, known: Real, knowledge: Knowledge) -> Real:
    total = np.where(np.all(np.abs(points) <= 2 * REACH, axis=1), 0.0, -1e9)
    for k, mode in enumerate(model.modes):
        if not np.isnan(known[k]):
            total = total - 0.5 * ((points[:, k] - known[k]) / knowledge.std) ** 2
            continue
        if knowledge.closeness is None:
            total = total - 0.5 * points[:, k] ** 2  # of one order, no more
            continue
        half = np.exp(0.5 * (points[:, k] - here[k]))[:, None]
        bearing, sensor = mode[2:4] / half, mode[4:6] * half
        largest = np.maximum(np.abs(sensor).max(axis=1), np.abs(bearing).max(axis=1))[:, None] + 1e-12
        growth = (sensor - bearing) * np.sign(bearing) / largest / knowledge.closeness
        falls = np.array(knowledge.outboard) & (growth < 0) | ~np.array(knowledge.outboard) & (growth > 0)
        growth = np.where(falls, growth / UNLIKELY_FALL, growth)
        total = total - 0.5 * (TAILS + 1) * np.sum(np.log1p(growth**2 / TAILS), axis=1)
    return np.asarray(total)


def _data_information(model: PlaneModel, residual: Real, jacobian: Real, free: np.ndarray) -> tuple[Real, Real]:
    """Slope and curvature of half the data's cost in a, every other parameter refitted, (n,) and (n, n)."""
    n = model.layout.n_modes
    places = np.flatnonzero(free)
    along = np.zeros((jacobian.shape[1], n))
    dropped = []
    for k in range(n):
        at = model.layout.mode(k).start
        for offset, sign in ((2, 0.5), (3, 0.5), (4, -0.5), (5, -0.5)):
            along[np.searchsorted(places, at + offset), k] = sign * model.theta[at + offset]
        # without one of its shapes the rest of a mode's parameters cannot mimic the change of split
        largest = at + 2 + int(np.argmax(np.abs(model.theta[at + 2 : at + 6])))
        dropped.append(int(np.searchsorted(places, largest)))
    change = jacobian @ along
    rest = np.delete(jacobian, dropped, axis=1)
    rest = rest / np.maximum(np.linalg.norm(rest, axis=0), 1e-300)
    q, _ = np.linalg.qr(rest)
    change = change - q @ (q.T @ change)
    left = residual - q @ (q.T @ residual)
    return np.asarray(change.T @ left), np.asarray(change.T @ change)
