"""How the splits of the modes' shapes are distributed about a joint fit, by data and knowledge together."""

from __future__ import annotations

import numpy as np

from service.identification.arrays import Real
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Knowledge, Posterior, log_prior, log_ratios

DRAWS, ROUNDS, ENOUGH = 4000, 8, 1000.0
"""Of the importance sampling: draws, rounds at most, and effective draws that are enough."""
FREEDOM = 5.0
"""Degrees of freedom of the Student density that is drawn from."""
STEP = 0.05
"""For the curvature of what is known."""
REACH = 6.0
"""No split lies further from where a fit has it, in logarithms."""


def posterior(
    model: PlaneModel, residual: Real, jacobian: Real, free: np.ndarray, knowledge: Knowledge, use_data: bool = True
) -> Posterior:
    """Second moments of the splits about those of the model.

    Parameters
    ----------
    model
        Joint fit of data and knowledge together.
    residual, jacobian
        Of the data alone, whitened, at the fit; columns are the free parameters.
    use_data
        False where the model is known to be wrong: the little that the data say of splits is then swamped.

    The misfit is quadratic in a (the effect is linear in phi_b^2), everything else refitted. Where the data tell a sum
    of several modes' a a hundred times better than each, what is likely is a thin straight ridge in a, and a bent one
    in its logarithm; where they tell little, it is knowledge, and the logarithms. Importance sampling half from a
    Student density of a, half from one of ln a, weighted by the mean of both (balance heuristic, Veach and Guibas,
    Proc. SIGGRAPH 1995), drawn in to the weighted draws until these are alike.
    """
    here = log_ratios(model)
    n = len(here)
    slope, curvature = np.zeros(n), np.zeros((n, n))
    if use_data:
        slope, curvature = _data_information(model, residual, jacobian, free)

    def log_density(points: Real) -> Real:
        change = np.exp(np.clip(here - points, -REACH, REACH)) - 1.0  # a - 1
        data = -0.5 * (2 * change @ slope + np.einsum("pk,kl,pl->p", change, curvature, change))
        inside = np.all(np.abs(points - here) <= REACH, axis=1)
        return np.asarray(np.where(inside, data + log_prior(model, points, knowledge).sum(axis=1), -1e300))

    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(np.linalg.inv(curvature + np.diag(_precision(model, here, knowledge))))
    centres, roots = np.zeros((2, n)), np.stack([root, root])  # of ln a, and of a - 1
    for _ in range(ROUNDS):
        z = rng.standard_normal((2, DRAWS // 2, n)) / np.sqrt(rng.chisquare(FREEDOM, (2, DRAWS // 2, 1)) / FREEDOM)
        in_logs, straight = centres[:, None] + z @ roots.swapaxes(1, 2)
        logs = np.concatenate([in_logs, np.log1p(straight[np.all(straight > -1.0, axis=1)])])
        logs = logs[np.all(np.abs(logs) <= REACH, axis=1)]
        drawn_from = (logs, np.expm1(logs))
        drawn = [_log_student(x, m, r) for x, m, r in zip(drawn_from, centres, roots, strict=True)]
        log_weight = log_density(here - logs) - np.logaddexp(drawn[0], drawn[1] + logs.sum(axis=1))
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        if 1.0 / np.sum(weight**2) > ENOUGH:
            break
        for k, x in enumerate(drawn_from):
            centres[k] = weight @ x
            away = x - centres[k]
            spread = (away * weight[:, None]).T @ away
            roots[k] = np.linalg.cholesky(spread + (1e-3 * np.diag(np.diag(spread)) + 1e-14 * np.eye(n)))
    points = here - logs
    # everything moves in proportion to a, not to its logarithm: a share that vanishes is a change of one, no more
    moved = 1.0 - np.exp(np.clip(here - points, -REACH, REACH))
    half = np.clip(0.5 * (points - here), -REACH, REACH)
    shapes = np.stack([weight @ np.expm1(-half) ** 2, weight @ np.expm1(half) ** 2], axis=1)
    return Posterior(here, (moved * weight[:, None]).T @ moved + 1e-12 * np.eye(n), shapes)


def _log_student(x: Real, centre: Real, root: Real) -> Real:
    """Log density of x (N, n) under a Student density of that centre and root of its spread, up to a constant."""
    z = np.linalg.solve(root, (x - centre).T)
    return np.asarray(
        -0.5 * (FREEDOM + len(root)) * np.log1p(np.sum(z**2, axis=0) / FREEDOM) - np.log(np.diag(root)).sum()
    )


def _precision(model: PlaneModel, here: Real, knowledge: Knowledge) -> Real:
    """Curvature of what is known of each split by itself, at least that of shapes of one order, (n,)."""
    known = ~np.isnan(knowledge.of_modes(model))
    up, at, down = (log_prior(model, (here + d)[None, :], knowledge)[0] for d in (STEP, 0.0, -STEP))
    own = np.maximum((2 * at - up - down) / STEP**2, 1.0)
    return np.asarray(np.where(known, knowledge.std**-2.0, own))


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
