"""What is not known of mass and sensors where a rotor that turns was fitted with other values than the datasheet's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.identification.arrays import Real
from service.identification.joint.one_rotor import OneRotor
from service.identification.joint.uncertainty import Uncertainty, moved_with
from service.identification.plane.layout import SHIFTS
from service.identification.rotating.fit import RotatingFit, residuals
from service.identification.rotating.layout import GAINS
from service.identification.rotating.points import SpeedPoints

HELD = ("mass_kg", *GAINS)
"""What the fit holds among its parameters; where the sensors are it has as known (`model.joined`)."""
STEP_M = 1e-5
"""Of a sensor's place, for derivatives."""


def with_held(u: Uncertainty, refined: RotatingFit, data: tuple[SpeedPoints, ...], rotor: OneRotor) -> Uncertainty:
    """The same with what is not known of mass, gains and places of sensors, as the planes together have them.

    Inertia and centre of gravity are this fit's own. It is for figures that no sensor's place enters: not for those of
    the loop, which are known as well as with all of this given, as ki and ks move with it.
    """
    layout, size = refined.model.layout, refined.model.layout.size
    _, slopes = residuals(refined.model, data, refined.weights, None)
    assert slopes is not None
    places = [layout.index(name) for name in HELD]
    given = np.column_stack([slopes[:, places], _by_place(refined, data)])
    at = [rotor.names.index(name) for name in (*HELD, *SHIFTS)]
    std = rotor.tolerances[at]
    covariance = np.outer(std, std) * rotor.covariance[np.ix_(at, at)]
    moved = moved_with(slopes[:, u.free], given, refined.fit.jacobian[len(slopes) :])
    to_all = np.zeros((size, len(at)))
    to_all[u.free] = moved
    to_all[places, range(len(places))] = 1.0
    total, from_data = to_all @ covariance @ to_all.T, np.zeros((size, size))
    fitted = np.ix_(u.free, u.free)
    total[fitted] += u.covariance
    from_data[fitted] = u.from_data
    free = u.free.copy()
    free[places] = True
    both = np.ix_(free, free)
    return replace(u, covariance=total[both], from_data=from_data[both], free=free)


def _by_place(refined: RotatingFit, data: tuple[SpeedPoints, ...]) -> Real:
    """Slopes of the residuals to where the sensors are, at A and B of both planes, (N, 2) per m."""
    x, y = refined.model.known

    def at(shifts_m: Real) -> Real:
        model = replace(refined.model, known=(x.with_sensors_at(shifts_m), y.with_sensors_at(shifts_m)))
        return residuals(model, data, refined.weights, None, gradient=False)[0]

    return np.column_stack([(at(d) - at(-d)) / (2 * STEP_M) for d in STEP_M * np.eye(2)])
