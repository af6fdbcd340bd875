"""Exact derivatives of the rotating model.

With Z q = Phi_b^T f a change of any part is a generalised force on q, or a change of the sensor map, so each column
costs one product.
"""

from __future__ import annotations

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane import amplifier
from service.identification.rotating.motion import Motion, TurningPoints
from service.identification.rotating.parameters import RotatingParameters


def gradients(rotor: RotatingParameters, points: TurningPoints, motion: Motion) -> tuple[Complex, Complex]:
    """Derivatives of i and y to every parameter, (P, 4, size) each."""
    layout, m = rotor.layout, motion.matrices
    push = motion.sensor[:, :, None] * (m.sensors @ motion.closed)  # y per generalised force
    per_force = push @ m.bearings.T
    d_i = np.zeros((*points.u.shape, layout.size), dtype=complex)
    d_y = np.zeros((*motion.seen.shape, layout.size), dtype=complex)  # not folded yet
    for k in range(2):
        _stiffness_columns(rotor, k, motion, push, per_force, d_y)
        _amplifier_columns(rotor, k, points, motion, per_force, d_i, d_y)
        _mode_columns(rotor, k, motion, push, per_force, d_y)
        _rigid_columns(rotor, k, motion, push, per_force, d_y)
    tilts = (1, rotor.coordinate(1, 0) - 1)
    d_y[:, :, layout.polar] = _turned(motion, push, *tilts, motion.s * motion.speed)
    for pair, (a, b) in enumerate(layout.pairs):
        at, places = layout.gyroscopic(pair), (rotor.coordinate(0, a), rotor.coordinate(1, b))
        d_y[:, :, at] = _turned(motion, push, *places, motion.s * motion.speed)
        d_y[:, :, at + 1] = _turned(motion, push, *places, 2 * motion.speed)
    return d_i, motion.folded(d_y)


def _turned(motion: Motion, push: Complex, x: int, y: int, gain: Complex | Real) -> Complex:
    """Change of y per unit of a skew coupling between two coordinates."""
    along_x, along_y = -gain * motion.q[:, y], gain * motion.q[:, x]
    return np.asarray(push[:, :, x] * along_x[:, None] + push[:, :, y] * along_y[:, None])


def _stiffness_columns(
    rotor: RotatingParameters, k: int, motion: Motion, push: Complex, per_force: Complex, d_y: Complex
) -> None:
    """Columns of ki and ks of one plane; a mode's own stiffness follows ks, see `plane.parameters`."""
    start, modes = rotor.layout.own[k].start, rotor.plane(k).modes
    for j in range(2):
        axis = 2 * k + j
        by_ki, by_ks = motion.coils[:, axis], motion.moved[:, axis]
        if motion.excess is not None:
            by_ki, by_ks = by_ki + motion.excess[1][:, axis], by_ks + motion.excess[2][:, axis]
        d_y[:, :, start + j] = per_force[:, :, axis] * by_ki[:, None]
        d_y[:, :, start + 2 + j] = per_force[:, :, axis] * by_ks[:, None]
        for mode in range(len(modes)):
            at = rotor.coordinate(k, mode)
            d_y[:, :, start + 2 + j] -= modes[mode, 2 + j] ** 2 * push[:, :, at] * motion.q[:, at, None]


def _amplifier_columns(
    rotor: RotatingParameters,
    k: int,
    points: TurningPoints,
    motion: Motion,
    per_force: Complex,
    d_i: Complex,
    d_y: Complex,
) -> None:
    """Columns of the amplifiers and of the delay of one plane."""
    plane, start = rotor.plane(k), rotor.layout.own[k].start
    delay, period = plane.delay_s + plane.known.computing_delay_s, plane.known.sample_time_s
    late = start + plane.layout.delay
    for j, place in enumerate(plane.layout.amplifiers):
        axis = 2 * k + j
        own = slice(start + place.start, start + place.stop)
        d_now = amplifier.sampled(points.omega, plane.theta[place], delay, period)[1] * points.u[:, axis, None]
        d_base = plane.base_band(j, motion.folding.omega)[1] * motion.folding.u_rows[axis][:, None]
        to_y = per_force[:, :, axis] * plane.ki[j]
        d_i[:, axis, own], d_i[:, axis, late] = d_now[:, :-1], d_now[:, -1]
        d_y[:, :, own] = to_y[:, :, None] * d_base[:, None, :-1]
        d_y[:, :, late] += to_y * d_base[:, -1, None]


def _mode_columns(
    rotor: RotatingParameters, k: int, motion: Motion, push: Complex, per_force: Complex, d_y: Complex
) -> None:
    """Columns of the modes of one plane: frequency, damping, shapes at bearings and sensors."""
    plane, start = rotor.plane(k), rotor.layout.own[k].start
    for number, mode in enumerate(plane.modes):
        at, coordinate = start + plane.layout.mode(number).start, rotor.coordinate(k, number)
        q, pushed = motion.q[:, coordinate, None], push[:, :, coordinate]
        d_y[:, :, at] = -2 * mode[0] * pushed * q
        d_y[:, :, at + 1] = -2 * motion.s[:, None] * pushed * q
        for j in range(2):
            axis = 2 * k + j
            by_force = pushed * motion.force[:, axis, None] + per_force[:, :, axis] * (plane.ks[j] * q)
            d_y[:, :, at + 2 + j] = by_force - 2 * plane.ks[j] * mode[2 + j] * pushed * q
            d_y[:, axis, at + 4 + j] = motion.sensor[:, axis] * q[:, 0]


def _rigid_columns(
    rotor: RotatingParameters, k: int, motion: Motion, push: Complex, per_force: Complex, d_y: Complex
) -> None:
    """What one plane adds to the columns of mass, inertia, centre of gravity and sensor gains."""
    layout, first = rotor.layout, rotor.coordinate(k, 0) - 2
    plane = rotor.plane(k)
    axes = slice(2 * k, 2 * k + 2)
    square = motion.s[:, None] ** 2
    at = layout.rigid.start
    for offset in range(2):
        d_y[:, :, at + offset] -= push[:, :, first + offset] * square * motion.q[:, first + offset, None]
    # a centre of gravity nearer to A shortens the arms there and lengthens those of B: every tilt arm falls by as much
    tilt = motion.q[:, first + 1, None]
    d_y[:, :, at + 2] -= push[:, :, first + 1] * motion.force[:, axes].sum(axis=1, keepdims=True)
    d_y[:, :, at + 2] -= (per_force[:, :, axes] @ plane.ks) * tilt
    d_y[:, axes, at + 2] -= motion.sensor[:, axes] * tilt
    gains = layout.gains.start
    for j in range(2):
        axis = 2 * k + j
        d_y[:, axis, gains + axis] = motion.seen[:, axis] / plane.sensor_gain[j]
