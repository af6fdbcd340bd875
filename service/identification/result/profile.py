"""Profile likelihoods of the extended set: the misfit's growth when one figure is held and all the rest are refitted.

Where the profile rises as the square of the distance in standard deviations, a figure is identifiable and its interval
is that of the covariance; where it stays flat, no data of this kind can tell it, whatever their noise (Raue et al.,
Bioinformatics 25, 2009). The aliases are followed to ten per cent, where any information would show.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real
from service.identification.joint.refine import Refined
from service.identification.joint.residuals import residuals
from service.identification.measured.data import Data
from service.identification.plane.layout import N_MODE
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Amplitude
from service.identification.priors.beyond import beyond_rows
from service.identification.priors.split import Posterior, Split, split_rows
from service.identification.statistics.least_squares import minimise

STEPS = (-2.0, -1.0, 1.0, 2.0)
"""Distances, in standard deviations, at which an identifiable figure is held."""
ALIAS_STEPS = (-0.1, 0.1)
"""Relative changes at which an alias is held."""
FLAT = 3.84
"""Growth of the cost that 95 % of all data sets keep to for one parameter."""


def profiles(
    refined: Refined, splits: Posterior | None, data: Data, std: dict[str, tuple[float, float]]
) -> dict[str, dict[str, Any]]:
    """Profiles of inertia and centre of gravity with the mass given, of the mass, and of all sensors' common gain.

    Parameters
    ----------
    refined
        Joint fit.
    std
        (estimate, standard deviation) of "transverse_inertia_kgm2" and "centre_of_gravity_m", from data alone.
    """
    model = refined.model
    free = refined.fit.free.copy()
    for name in std:
        free[model.layout.index(name)] = True
    cost = _Cost(refined, splits, data, refined.amplitude)
    best, lowest = cost.fitted(model.theta, free)
    out: dict[str, dict[str, Any]] = {}
    for name, (_, sd) in std.items():
        place = model.layout.index(name)
        held = free.copy()
        held[place] = False
        values, growth = [], []
        for step in STEPS:
            theta = best.copy()
            theta[place] = best[place] + step * sd
            values.append(float(theta[place]))
            growth.append(cost.fitted(theta, held)[1] - lowest)
        out[name] = _document(float(best[place]), values, growth, float(np.mean(growth)) < FLAT / 4)
    at_amplitude = [cost.fitted(_louder(model, best, 1 + step), free)[1] - lowest for step in ALIAS_STEPS]
    # the alias of sensors and ki is one of the small signal: a magnet of known bias current tells its own gap
    small = _Cost(refined, splits, data, None)
    best_small, lowest_small = small.fitted(best, free)
    for name, moved, start, c, low in (
        ("mass_kg", _heavier, best, cost, lowest),
        ("common_sensor_gain", _louder, best_small, small, lowest_small),
    ):
        growth = [c.fitted(moved(model, start, 1 + step), free)[1] - low for step in ALIAS_STEPS]
        place = model.layout.index("mass_kg" if name == "mass_kg" else "sensor_gain_A")
        values = [float(start[place] * (1 + step)) for step in ALIAS_STEPS]
        # rounding of a cost far from the noise is no information
        out[name] = _document(float(start[place]), values, growth, max(growth) < max(FLAT, 1e-6 * low))
    out["common_sensor_gain"]["cost_growth_at_amplitude"] = at_amplitude
    return out


def _document(best: float, values: list[float], growth: list[float], flat: bool) -> dict[str, Any]:
    return {"best": best, "held_at": values, "cost_growth": growth, "flat": flat}


def _heavier(model: PlaneModel, theta: Real, factor: float) -> Real:
    """Mass, inertia, ki and ks in one proportion, shapes to unit modal mass: the same motion per current."""
    layout, out = model.layout, theta.copy()
    out[0:4] *= factor
    out[layout.extended.start : layout.extended.start + 2] *= factor
    for k in range(layout.n_modes):
        at = layout.mode(k).start
        out[at + 2 : at + N_MODE] /= np.sqrt(factor)
    return out


def _louder(model: PlaneModel, theta: Real, factor: float) -> Real:
    """A gain common to all sensors, and ki less by as much."""
    out = theta.copy()
    out[0:2] /= factor
    out[model.layout.extended.start + 3 : model.layout.extended.start + 5] *= factor
    return out


class _Cost:
    """The joint fit's cost, with what is known of the splits, and of modes beyond the band."""

    def __init__(self, refined: Refined, splits: Posterior | None, data: Data, amplitude: Amplitude | None) -> None:
        self._refined, self._data, self._amplitude = refined, data, amplitude
        self._beyond = refined.model.modes[:, 0] > data.plant.omega.max()
        self._split = None if splits is None else Split(splits.log_ratios, 1.0)
        self._root = None if splits is None else np.linalg.inv(np.linalg.cholesky(splits.covariance))

    def fitted(self, theta: Real, free: NDArray[np.bool_]) -> tuple[Real, float]:
        """Parameters and cost after a refit of ``free`` from ``theta``."""
        refined, split, root = self._refined, self._split, self._root

        def residual(t: Real, gradient: bool) -> tuple[Real, Real | None] | None:
            trial = refined.model.at(t)
            if not trial.is_physical:
                return None
            r, j = residuals(trial, self._data, refined.weights, self._amplitude, gradient)
            if split is None or root is None or not trial.layout.n_modes:
                return r, j
            more, slope = split_rows(trial, split)
            known, its_slope = beyond_rows(trial, self._beyond)
            whole = np.concatenate([r, known, root @ more])
            return whole, None if j is None else np.concatenate([j, its_slope, root @ slope])

        if not refined.model.at(theta).is_physical:  # nothing can be held there
            return theta, float("inf")
        fit = minimise(residual, theta, free, 15, 1e-3)
        return fit.theta, fit.cost
