"""Continuous linear state space of a rig between the held control signal and its sensors.

State: amplifiers (current and its rate), eddy-current states, mechanical coordinates and their rates, eddy-current
states of the gap, sensor lags. Everything nonlinear enters as a correction: a bearing force (``force_input``) and a
rate of current that the supply cannot give (``slew_input``). The time loop integrates the linear part exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim import actuator, rotor
from sim.actuator import OperatingPoint, force_rotation
from sim.rig import SHORTEST_LAG_S, Array, Rig

EddyStates = tuple[Array, Array]
"""Poles and weights of `sim.actuator.eddy_states`."""


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
    pulled: Array
    """(n, z) displacement that the magnets answer with ks: as far as eddy currents hold back the flux of the gap"""
    sensor: Array
    """(n, z) sensor output, before delay and noise"""


@dataclass(frozen=True)
class _Places:
    """Where the states of each part begin, and the mechanical ones."""

    eddy: int
    q: slice
    v: slice
    gap: int
    """Of the eddy currents that hold back the flux of the gap."""
    sensors: int
    lags: int
    """Of what stands between u and the amplifiers."""
    size: int


def state_space(rig: Rig, point: OperatingPoint) -> StateSpace:
    """State space with the magnets linearised at ``point``."""
    n, mechanics = rig.n_axes, rotor.mechanics(rig)
    m = rig.magnets
    eddy = [
        actuator.eddy_states(t, m.eddy_corner_rad_s, m.eddy_free_share) if t > 0 else None
        for t in m.eddy_time_constant_s
    ]
    n_eddy = sum(len(e[0]) - 1 for e in eddy if e)
    at = _places(rig, n_eddy, n_eddy if m.eddy_displacement_share else 0, len(mechanics.mass))
    states, inputs = (n, at.size), (at.size, n)
    ss = StateSpace(
        A=np.zeros((at.size, at.size)),
        drive=np.zeros(inputs),
        force_input=np.zeros(inputs),
        slew_input=np.zeros(inputs),
        current=np.zeros(states),
        current_rate=np.zeros(states),
        current_rate_input=np.zeros((n, n)),
        flux=np.zeros(states),
        bearing=np.zeros(states),
        pulled=np.zeros(states),
        sensor=np.zeros(states),
    )
    _fill_amplifiers(ss, rig, at)
    _fill_eddy_currents(ss, rig, at, eddy)
    _fill_rotor(ss, rig, at, mechanics, point, eddy)
    _fill_sensors(ss, rig, at)
    return ss


def _amplifier_order(rig: Rig) -> int:
    return 1 if rig.amplifiers.damping_ratio is None else 2


def _places(rig: Rig, n_eddy: int, n_gap: int, n_q: int) -> _Places:
    """The states in their order: amplifiers, eddy currents, coordinates, their rates, the gap's, sensors, lags."""
    n, amp, sensors = rig.n_axes, rig.amplifiers, rig.sensors
    sizes = [
        _amplifier_order(rig) * n,
        n_eddy,
        n_q,
        n_q,
        n_gap,
        int(np.isfinite(sensors.bandwidth_rad_s).sum() + (sensors.lag_s > SHORTEST_LAG_S).sum()),
        n if amp.lag_s > SHORTEST_LAG_S else 0,
    ]
    eddy, q, v, gap, sensor, lags, end = np.cumsum(sizes).tolist()
    return _Places(eddy, slice(q, v), slice(v, gap), gap, sensor, lags, end)


def _fill_amplifiers(ss: StateSpace, rig: Rig, at: _Places) -> None:
    """From control signal to coil current."""
    amp, order = rig.amplifiers, _amplifier_order(rig)
    for axis in range(rig.n_axes):
        k, w = order * axis, amp.natural_frequency_rad_s[axis]
        ss.current[axis, k] = 1.0
        ss.slew_input[k, axis] = 1.0
        if amp.damping_ratio is None:
            ss.A[k, k] = -w
            ss.drive[k] = w * amp.gain[axis] * amp.crosstalk[axis]
        else:
            ss.A[k, k + 1] = 1.0
            ss.A[k + 1, k : k + 2] = -(w**2), -2 * amp.damping_ratio[axis] * w
            ss.drive[k + 1] = w**2 * amp.gain[axis] * amp.crosstalk[axis]
            ss.slew_input[k + 1, axis] = -2 * amp.damping_ratio[axis] * w * amp.slew_seen
        if amp.lag_s > SHORTEST_LAG_S:  # the lag stands between u and the amplifier
            entry, lag = k + order - 1, at.lags + axis
            ss.A[entry, lag] = w**order * amp.gain[axis]
            ss.drive[entry] = 0.0
            ss.A[lag, lag] = -1 / amp.lag_s
            ss.drive[lag] = amp.crosstalk[axis] / amp.lag_s
        ss.current_rate[axis], ss.current_rate_input[axis] = ss.A[k], ss.drive[k]


def _fill_eddy_currents(ss: StateSpace, rig: Rig, at: _Places, eddy: Sequence[EddyStates | None]) -> None:
    """From coil current to the current that makes flux, by the poles and weights of each axis."""
    e, order = at.eddy, _amplifier_order(rig)
    for axis, realisation in enumerate(eddy):
        if realisation is None:
            ss.flux[axis] = ss.current[axis]
            continue
        k = order * axis
        poles, weights = realisation
        ss.flux[axis, k] = weights[0]
        for pole, weight in zip(poles[1:], weights[1:], strict=True):
            ss.A[e, e] = -pole
            ss.A[e, k] = pole
            ss.flux[axis, e] = weight
            e += 1


def _fill_rotor(
    ss: StateSpace, rig: Rig, at: _Places, m: rotor.Mechanics, point: OperatingPoint, eddy: Sequence[EddyStates | None]
) -> None:
    """From flux to displacements, the magnets' stiffness closed."""
    q, v = at.q, at.v
    ss.bearing[:, q] = m.bearing_map
    _fill_gap(ss, rig, at, eddy)
    push = np.linalg.solve(m.mass, m.force_map)
    ss.A[q, v] = np.eye(len(m.mass))
    ss.A[v, q] -= np.linalg.solve(m.mass, m.stiffness)
    ss.A[v, v] -= np.linalg.solve(m.mass, m.damping)
    ss.A[v] += push @ force_rotation(rig) @ (point.ki[:, None] * ss.flux + point.ks[:, None] * ss.pulled)
    ss.force_input[v] = push
    ss.sensor[:, q] = rig.sensors.gain[:, None] * m.sensor_map


def _fill_gap(ss: StateSpace, rig: Rig, at: _Places, eddy: Sequence[EddyStates | None]) -> None:
    """From displacements at the bearings to those that the magnets answer; see `sim.actuator.gap_factor`."""
    g, share = at.gap, rig.magnets.eddy_displacement_share
    for axis, realisation in enumerate(eddy):
        ss.pulled[axis] = ss.bearing[axis]
        if realisation is None or not share:
            continue
        poles, weights = realisation
        ss.pulled[axis] *= 1 - share * (1 - weights[0])
        for pole, weight in zip(poles[1:], weights[1:], strict=True):
            ss.A[g] = pole * ss.bearing[axis]
            ss.A[g, g] = -pole
            ss.pulled[axis, g] = share * weight
            g += 1


def _fill_sensors(ss: StateSpace, rig: Rig, at: _Places) -> None:
    """From displacements to what the sensors put out, through one pole after another."""
    s = at.sensors
    for axis in range(rig.n_axes):
        lag_s = float(rig.sensors.lag_s[axis])
        further = 1 / lag_s if lag_s > SHORTEST_LAG_S else math.inf
        for w in (float(rig.sensors.bandwidth_rad_s[axis]), further):
            if math.isinf(w):
                continue
            ss.A[s] = w * ss.sensor[axis]
            ss.A[s, s] = -w
            ss.sensor[axis] = 0.0
            ss.sensor[axis, s] = 1.0
            s += 1
