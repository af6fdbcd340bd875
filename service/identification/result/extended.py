"""The extended set: mass, inertia, centre of gravity and sensor gains, and which of them the data can tell.

u, i and y at small signal know force only as ki i + ks x and the rotor only as motion per force. So the scale of force
against mass is an exact alias (mass, inertia, ki and ks in one proportion), and so is a gain common to all sensors with
ki. What is left is read from the Fisher information of the joint fit with the whole set free.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from service.identification.arrays import Real
from service.identification.joint.refine import Refined
from service.identification.joint.residuals import residuals
from service.identification.joint.uncertainty import Uncertainty
from service.identification.measured.data import Data
from service.identification.plane.layout import EXTENDED
from service.identification.priors.split import HELD, Posterior
from service.identification.result.figures import correlations
from service.identification.result.profile import profiles
from service.identification.statistics.least_squares import covariance_of
from sim.datasheet import Datasheet

ALIASES = (
    "mass_kg, transverse_inertia_kgm2, ki and ks in one proportion (only force per mass is seen)",
    "a gain common to all sensors and ki (exact at small signal; the gain of one sensor alone is not)",
)


def extended_report(
    refined: Refined, splits: Posterior | None, data: Data, datasheet: Datasheet, u: Uncertainty
) -> dict[str, Any]:
    """Inertia and centre of gravity with the mass known, and what can be told of the whole set.

    Where these were held within the datasheet's tolerances, as mass and sensors were, ``u`` has what is not known of
    all that together: their deviations, and how they go together with other figures, are by that.
    """
    model = refined.model
    r, jacobian = residuals(model, data, refined.weights, refined.amplitude)
    assert jacobian is not None
    full, rest = _with_knowledge(refined, splits, r, jacobian)
    told = {"transverse_inertia_kgm2": datasheet.transverse_inertia_kgm2, "centre_of_gravity_m": 0.0}
    asked = tuple(told)
    free = refined.fit.free.copy()
    for name in asked:
        free[model.layout.index(name)] = True
    step, covariance = _one_step(full[:, free], rest, 1.0 if u.adequate else u.scale)
    places = np.flatnonzero(free)
    out: dict[str, Any] = {}
    tolerance = {
        "transverse_inertia_kgm2": datasheet.tolerance.transverse_inertia * datasheet.transverse_inertia_kgm2,
        "centre_of_gravity_m": datasheet.tolerance.sensor_position_m,
    }
    within = all(u.free[model.layout.index(name)] for name in asked)
    spread: dict[str, tuple[float, float]] = {}
    for name in asked:
        place = model.layout.index(name)
        k = int(np.searchsorted(places, place))
        spread[name] = float(model.theta[place] + step[k]), float(np.sqrt(covariance[k, k]))
        value, std = spread[name]
        better = std < tolerance[name]
        if within:
            at = int(np.searchsorted(np.flatnonzero(u.free), place))
            std = float(np.sqrt(u.covariance[at, at]))
            # the datasheet's tolerance is part of it: the data alone must tell as much again
            better = np.sqrt(2) * std < tolerance[name]
        out[name] = {"value": value, "std": std, "nominal": told[name], "identifiable": bool(better)}
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    wider = u if within else replace(u, covariance=covariance, from_data=covariance, free=free)
    shown = {"transverse inertia": asked[0], "centre of gravity": asked[1]}
    out["correlations"] = correlations(model, wider, controller, shown).document()
    out["profile"] = profiles(refined, splits, data, spread)
    out["identifiable"] = all(out[name]["identifiable"] for name in asked)
    out["given"] = {"mass_kg": float(model.theta[model.layout.index("mass_kg")])}
    scale = np.abs(model.theta)
    scale[model.layout.index("centre_of_gravity_m")] = sum(datasheet.bearing_from_cog_m) / 2
    scale[model.layout.delay] = datasheet.sample_time_s
    out |= _rank(full, refined, scale)
    out["aliases"] = list(ALIASES)
    return out


def _with_knowledge(refined: Refined, splits: Posterior | None, r: Real, jacobian: Real) -> tuple[Real, Real]:
    """Jacobian to every parameter and residuals: of the data, and of what is known beside them."""
    n_data = len(r)
    n_splits = 0 if splits is None else len(splits.log_ratios)
    n_known = len(refined.fit.residual) - n_splits  # the data, and what is known beside the splits
    known, wide = (np.zeros((n, refined.model.layout.size)) for n in (n_known - n_data, n_splits))
    known[:, refined.fit.free] = refined.fit.jacobian[n_data:n_known]
    if splits is not None:
        # what is known of the shapes' splits, in units of its own spread
        root = np.linalg.inv(np.linalg.cholesky(splits.covariance))
        wide[:, refined.fit.free] = root @ (HELD * refined.fit.jacobian[n_known:])
    rest = np.concatenate([r, refined.fit.residual[n_data:n_known], np.zeros(n_splits)])
    return np.vstack([jacobian, known, wide]), rest


def _one_step(jacobian: Real, residual: Real, widen: float) -> tuple[Real, Real]:
    """Gauss-Newton step and covariance: the fit is at its optimum in all but the added parameters."""
    norms = np.linalg.norm(jacobian, axis=0)
    norms[norms == 0] = 1.0
    step = -np.linalg.lstsq(jacobian / norms, residual, rcond=1e-12)[0] / norms
    return step, covariance_of(jacobian) * widen**2


def _rank(jacobian: Real, refined: Refined, scale: Real) -> dict[str, Any]:
    """Rank and conditioning of the Fisher information with the whole extended set free, by relative parameters."""
    layout = refined.model.layout
    free = refined.fit.free.copy()
    free[layout.extended] = True
    relative = jacobian[:, free] * scale[free]
    _, singular, vt = np.linalg.svd(relative, full_matrices=False)
    names = np.array(layout.names)[free]
    blind = []
    # a direction is blind when a change of 100 % along it is worth less than a standard deviation
    for value, direction in zip(singular[::-1], vt[::-1], strict=True):
        if value >= 1.0:
            break
        big = np.argsort(-np.abs(direction))[:8]
        blind.append(
            {
                "std_relative": float(1.0 / max(value, 1e-12)),
                "combination": {str(names[k]): float(direction[k]) for k in big if abs(direction[k]) > 0.05},
            }
        )
    return {
        "rank": int(np.sum(singular >= 1.0)),
        "parameters": len(names),
        "condition_number": float(singular[0] / max(singular[-1], 1e-300)),
        "blind_directions": blind,
        "extended_set": list(EXTENDED),
    }
