"""Continuous linear state space of a rig between the held control signal and its sensors.

State: amplifiers (current and its rate), eddy-current states, mechanical coordinates and their rates, sensor
lags. Everything nonlinear enters as a correction: a bearing force (``force_input``) and a rate of current that
the supply cannot give (``slew_input``). The time loop integrates the linear part exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim import actuator, rotor
from sim.actuator import OperatingPoint, force_rotation
from sim.rig import SHORTEST_LAG_S, Array, Rig


@dataclass(frozen=True)
class StateSpace:
    """z' = A z + drive u(t - delay) + force_input df + slew_input dv; rows pick physical signals from z."""

    A: Array
    """(z, z)"""
    drive: Array
    """(z, n) per control signal"""
    force_input: Array
    """(z, n) per force on the rotor at the bearings beyond the linear one, N"""
    slew_input: Array
    """(z, n) per rate of current beyond the linear one, A/s"""
    current: Array
    """(n, z) coil current"""
    current_rate: Array
    """(n, z) rate of the coil current that the linear amplifier asks for, per state"""
    current_rate_input: Array
    """(n, n) the same per control signal: what drives an amplifier of first order drives its rate at once"""
    flux: Array
    """(n, z) current after eddy currents"""
    bearing: Array
    """(n, z) displacement at the bearings"""
    sensor: Array
    """(n, z) sensor output, before delay and noise"""


def state_space(rig: Rig, point: OperatingPoint) -> StateSpace:
    """State space with the magnets linearised at ``point``."""
    n = rig.n_axes
    amp, m = rig.amplifiers, rotor.mechanics(rig)
    order = 1 if amp.damping_ratio is None else 2
    n_q = len(m.mass)
    eddy = [
        actuator.eddy_states(t, rig.magnets.eddy_corner_rad_s) if t > 0 else None
        for t in rig.magnets.eddy_time_constant_s
    ]
    sizes = [
        order * n,
        sum(len(e[0]) - 1 for e in eddy if e),
        n_q,
        n_q,
        int(np.isfinite(rig.sensors.bandwidth_rad_s).sum() + (rig.sensors.lag_s > SHORTEST_LAG_S).sum()),
        n if amp.lag_s > SHORTEST_LAG_S else 0,
    ]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    n_z = int(starts[-1])
    A, drive = np.zeros((n_z, n_z)), np.zeros((n_z, n))
    current, rate, flux = np.zeros((n, n_z)), np.zeros((n, n_z)), np.zeros((n, n_z))
    slew, rate_input = np.zeros((n_z, n)), np.zeros((n, n))
    e, lagged = int(starts[1]), int(starts[5])
    for axis in range(n):
        k, w = order * axis, amp.natural_frequency_rad_s[axis]
        current[axis, k] = 1.0
        slew[k, axis] = 1.0
        if amp.damping_ratio is None:
            A[k, k] = -w
            drive[k] = w * amp.gain[axis] * amp.crosstalk[axis]
        else:
            A[k, k + 1] = 1.0
            A[k + 1, k : k + 2] = -(w**2), -2 * amp.damping_ratio[axis] * w
            drive[k + 1] = w**2 * amp.gain[axis] * amp.crosstalk[axis]
            slew[k + 1, axis] = -2 * amp.damping_ratio[axis] * w * amp.slew_seen
        if amp.lag_s > SHORTEST_LAG_S:  # the lag stands between u and the amplifier
            entry = k + order - 1
            A[entry, lagged + axis] = w**order * amp.gain[axis]
            drive[entry] = 0.0
            A[lagged + axis, lagged + axis] = -1 / amp.lag_s
            drive[lagged + axis] = amp.crosstalk[axis] / amp.lag_s
        rate[axis], rate_input[axis] = A[k], drive[k]
        realisation = eddy[axis]
        if realisation is None:
            flux[axis] = current[axis]
            continue
        poles, weights = realisation
        flux[axis, k] = weights[0]
        for pole, weight in zip(poles[1:], weights[1:], strict=True):
            A[e, e] = -pole
            A[e, k] = pole
            flux[axis, e] = weight
            e += 1
    q, v = slice(int(starts[2]), int(starts[3])), slice(int(starts[3]), int(starts[4]))
    bearing = np.zeros((n, n_z))
    bearing[:, q] = m.bearing_map
    push = np.linalg.solve(m.mass, m.force_map)
    A[q, v] = np.eye(n_q)
    A[v, q] -= np.linalg.solve(m.mass, m.stiffness)
    A[v, v] -= np.linalg.solve(m.mass, m.damping)
    rotation = force_rotation(rig)
    A[v] += push @ rotation @ (point.ki[:, None] * flux + point.ks[:, None] * bearing)
    force_input = np.zeros((n_z, n))
    force_input[v] = push
    sensor = np.zeros((n, n_z))
    sensor[:, q] = rig.sensors.gain[:, None] * m.sensor_map
    s = int(starts[4])
    for axis in range(n):
        lag_s = float(rig.sensors.lag_s[axis])
        further = 1 / lag_s if lag_s > SHORTEST_LAG_S else math.inf
        for w in (float(rig.sensors.bandwidth_rad_s[axis]), further):
            if math.isinf(w):
                continue
            A[s] = w * sensor[axis]
            A[s, s] = -w
            sensor[axis] = 0.0
            sensor[axis, s] = 1.0
            s += 1
    return StateSpace(A, drive, force_input, slew, current, rate, rate_input, flux, bearing, sensor)
