"""Exact derivatives of a plane's currents and displacements to every parameter of its model."""

from __future__ import annotations

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane import amplifier
from service.identification.plane.layout import N_MODE
from service.identification.plane.motion import Motion, combined, excess
from service.identification.plane.parameters import PlaneParameters
from service.identification.plane.prediction import Points


def gradients(plane: PlaneParameters, points: Points, motion: Motion) -> tuple[Complex, Complex]:
    """Derivatives of i and y to every parameter, (size, 2, P) each."""
    d_i = np.zeros((plane.layout.size, 2, len(points.omega)), dtype=np.complex128)
    d_y = displacement_gradient(plane, motion)
    amplifier_gradient(plane, points, motion, d_i, d_y)
    extended_gradient(plane, motion, d_y)
    return d_i, motion.folding.folded(d_y)


def displacement_gradient(plane: PlaneParameters, motion: Motion) -> Complex:
    """Derivatives of y to ki, ks and the modes, the others zero, (size, 2, P + 2 K): not folded yet."""
    layout, loop = plane.layout, motion.loop
    d_y = np.zeros((layout.size, *motion.moved.shape), dtype=np.complex128)
    per_force = loop.through.transpose(1, 0, 2)  # [force, output]
    by_ki, by_ks = motion.coils, motion.moved
    if motion.amplitude is not None:
        slopes, n = motion.excess_slopes or excess(plane, motion.amplitude)[1:], motion.folding.n
        by_ki, by_ks = by_ki.copy(), by_ks.copy()
        by_ki[:, :n] += slopes[0]
        by_ks[:, :n] += slopes[1]
    np.multiply(per_force, by_ki[:, None], d_y[0:2])
    np.multiply(per_force, by_ks[:, None], d_y[2:4])
    n = layout.n_modes
    if n:
        start = layout.mode(0).start
        block = d_y[start : start + N_MODE * n].reshape(n, N_MODE, 2, -1)
        by_square = _mode_gradient(plane, motion, block)
        # w^2 = nu^2 + phi_b^T Ks phi_b moves with ks
        d_y[2:4] += combined(plane.modes[:, 2:4].T ** 2, by_square.reshape(n, -1)).reshape(2, 2, -1)
    return d_y


def _mode_gradient(plane: PlaneParameters, motion: Motion, block: Complex) -> Complex:
    """Fill the derivatives to all modes' parameters, (n, 6, 2, P); returns those to their w^2, (n, 2, P)."""
    loop, modes, ks = motion.loop, plane.modes, plane.ks
    n = len(modes)
    gain, bearings, sensors = loop.gain[2:], loop.bearings[2:], loop.sensors[2:]
    moved = gain * combined(bearings, motion.total)  # modal displacement
    feedback = loop.through.transpose(1, 0, 2) * ks[:, None, None]  # dy per change of x_b, loop closed through ks
    # closed-loop shapes at the sensors
    seen = combined(bearings, feedback.reshape(2, -1)).reshape(n, 2, -1) + sensors[:, :, None] * loop.sensor
    by_square = seen * (-gain * moved)[:, None]
    np.multiply(by_square, (2 * modes[:, 0])[:, None, None], block[:, 0])
    np.multiply(by_square, 2j * loop.omega, block[:, 1])
    np.multiply(seen[:, None], (gain[:, None] * motion.total)[:, :, None], block[:, 2:4])
    block[:, 2:4] += feedback * moved[:, None, None]
    block[:, 2:4] += (2 * ks * bearings)[:, :, None, None] * by_square[:, None]
    block[:, 4, 0], block[:, 5, 1] = moved * loop.sensor[0], moved * loop.sensor[1]
    return by_square


def amplifier_gradient(plane: PlaneParameters, points: Points, motion: Motion, d_i: Complex, d_y: Complex) -> None:
    """Fill the derivatives to the amplifiers' parameters and the delay; d_i (size, 2, P), d_y (size, 2, P + 2 K)."""
    layout, folding = plane.layout, motion.folding
    delay, period = plane.delay_s + plane.known.computing_delay_s, plane.known.sample_time_s
    for j, place in enumerate(layout.amplifiers):
        to_force = motion.loop.through[:, j] * plane.ki[j]
        d_now = amplifier.sampled(points.omega, plane.theta[place], delay, period)[1].T * points.u_rows[j]
        d_base = plane.base_band(j, folding.omega)[1].T * folding.u_rows[j]
        d_i[place, j], d_i[layout.delay, j] = d_now[:-1], d_now[-1]
        d_y[place] = to_force * d_base[:-1, None]
        d_y[layout.delay] += to_force * d_base[-1]


def extended_gradient(plane: PlaneParameters, motion: Motion, d_y: Complex) -> None:
    """Fill the derivatives to what is given: the rotor's mass and geometry, and its sensors, (size, 2, P + 2 K)."""
    mass, inertia = plane.theta[plane.layout.extended][:2]
    loop, total = motion.loop, motion.total
    at = plane.layout.extended.start
    gain = loop.gain[0]
    feedback = loop.through * plane.ks[:, None]

    def seen(bearing: Real, sensor: Real) -> Complex:
        """Closed-loop shape at the sensors, (2, P + 2 K)."""
        return np.asarray(sensor[:, None] * loop.sensor + feedback[:, 0] * bearing[0] + feedback[:, 1] * bearing[1])

    for k, value in enumerate((mass, inertia)):
        bearing, sensor = loop.bearings[k], loop.sensors[k]
        d_y[at + k] = seen(bearing, sensor) * (-gain * (bearing @ total) / value)
    arm, arm_s = np.asarray(loop.bearings[1] * np.sqrt(inertia)), np.asarray(loop.sensors[1] * np.sqrt(inertia))
    turn, push = gain * (arm @ total) / inertia, gain * total.sum(axis=0) / inertia
    # arms shrink by the shift: d(phi_s phi_b^T)/dshift = -(1 arm_b^T + arm_s 1^T)/I
    both: Real = np.ones(2)
    d_y[at + 2] = -(seen(both, both) * turn + seen(arm, arm_s) * push)
    for j in range(2):
        d_y[at + 3 + j, j] = motion.seen[j] / plane.sensor_gain[j]
        # farther from the centre a sensor sees more of the tilt, B of the opposite one
        d_y[plane.layout.shifts.start + j, j] = (1.0, -1.0)[j] * loop.sensor[j] * turn
