"""How a rotor that turns moves: its equations of motion, and what follows from them at the points.

Coordinates are, per plane, the translation of the centre of gravity, the tilt, and the flexible modes of unit modal
mass; M q'' + (D + W G) q' + (K + W C - Phi_b^T Ks Phi_b) q = Phi_b^T Ki i (Genta, Dynamics of Rotating Systems, 2005,
eq. 2.14 for the tilts and chapter 3 for modes). G holds the polar inertia between the tilts, and for a mode that both
planes have, g between its two copies; C holds what damping that turns with the shaft does to them.

As of a plane, y is what the sampler makes of the motion at the lines and at their aliases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.plane import amplifier
from service.identification.plane.force_law import excess_force
from service.identification.plane.prediction import Amplitude, Folding, Points
from service.identification.rotating.parameters import RotatingParameters


@dataclass(frozen=True)
class TurningPoints:
    """Where the model is evaluated: one row per excited point."""

    omega: Real
    """(P,) rad/s."""
    speed: Real
    """(P,) rad/s."""
    u: Complex
    """(P, 4) A."""

    def folding(self, sample_time_s: float) -> Folding:
        """The points with the aliases that the sampler folds onto them; the speed at them is that of their line."""
        return Folding.of(Points(self.omega, self.u), sample_time_s)


@dataclass(frozen=True)
class Matrices:
    """Equations of motion of the free rotor in n coordinates; damping and stiffness are ``+ W`` times the couplings."""

    mass: Real
    """(n,) of the diagonal; so are damping and stiffness."""
    damping: Real
    stiffness: Real
    gyroscopic: Real
    """(n, n) skew."""
    circulatory: Real
    """(n, n) skew."""
    bearings: Real
    """(4, n)"""
    sensors: Real
    """(4, n) without the sensors' gains."""

    @staticmethod
    def of(rotor: RotatingParameters) -> Matrices:
        """Of a rig; both tilts turn by the polar inertia, pairs of modes by g."""
        sizes = [2 + p.n_modes for p in rotor.layout.planes]
        n = sum(sizes)
        mass, damping, stiffness = np.ones(n), np.zeros(n), np.zeros(n)
        bearings, sensors = np.zeros((4, n)), np.zeros((4, n))
        gyroscopic, circulatory = np.zeros((n, n)), np.zeros((n, n))
        for k, plane in enumerate(rotor.planes):
            start, rows = k * sizes[0], slice(2 * k, 2 * k + 2)
            columns = slice(start, start + sizes[k])
            m = plane.modes
            mass[start : start + 2] = rotor.theta[rotor.layout.rigid][:2]
            damping[start + 2 : columns.stop] = 2 * m[:, 1]
            stiffness[start + 2 : columns.stop] = m[:, 0] ** 2 + m[:, 2:4] ** 2 @ plane.ks
            scale = np.sqrt(mass[start : start + 2])
            rigid_b, rigid_s = plane.rigid_shapes
            bearings[rows, columns] = np.hstack([rigid_b * scale, m[:, 2:4].T])
            sensors[rows, columns] = np.hstack([rigid_s * scale, m[:, 4:6].T])
        tilts = (1, sizes[0] + 1)
        gyroscopic[tilts], gyroscopic[tilts[::-1]] = rotor.polar_inertia, -rotor.polar_inertia
        for pair, (a, b) in enumerate(rotor.layout.pairs):
            x, y = rotor.coordinate(0, a), rotor.coordinate(1, b)
            g, h = rotor.coupling(pair)
            gyroscopic[x, y], gyroscopic[y, x] = g, -g
            circulatory[x, y], circulatory[y, x] = 2 * h, -2 * h
        return Matrices(mass, damping, stiffness, gyroscopic, circulatory, bearings, sensors)


def inverse_dynamics(m: Matrices, ks: Real, s: Complex, speed: Real) -> Complex:
    """(M s^2 + (D + W G) s + K + W C - Phi_b^T Ks Phi_b)^-1, (P, n, n)."""
    n = len(m.mass)
    turning = speed[:, None, None] * (m.gyroscopic * s[:, None, None] + m.circulatory)
    dynamic = turning - m.bearings.T @ (ks[:, None] * m.bearings)
    diagonal = np.arange(n)
    dynamic[:, diagonal, diagonal] += m.mass * s[:, None] ** 2 + m.damping * s[:, None] + m.stiffness
    return np.asarray(np.linalg.inv(dynamic))


@dataclass(frozen=True)
class Motion:
    """How the rotor moves at the points, and behind them at their aliases, P + 2 K rows; there magnets are linear."""

    folding: Folding
    s: Complex
    """(P + 2 K,)"""
    speed: Real
    """(P + 2 K,)"""
    matrices: Matrices
    closed: Complex
    """(P + 2 K, n, n) coordinates per generalised force, the magnets' stiffness closed."""
    q: Complex
    """(P + 2 K, n)"""
    force: Complex
    """(P + 2 K, 4) all of the magnets' force."""
    moved: Complex
    """(P + 2 K, 4) displacement at the bearings."""
    seen: Complex
    """(P + 2 K, 4) displacement at the sensors, not folded yet."""
    sensor: Complex
    """(P + 2 K, 4)"""
    i: Complex
    """(P, 4) sampled current."""
    coils: Complex
    """(P + 2 K, 4) base-band current."""
    excess: tuple[Complex, Complex, Complex] | None
    """Of the force law, and its derivatives to ki and ks, (P + 2 K, 4) each, nil at the aliases."""

    @staticmethod
    def of(rotor: RotatingParameters, points: TurningPoints, amplitude: Amplitude | None) -> Motion:
        """At the points; ``amplitude``: see `RotatingModel.predict`."""
        folding = points.folding(rotor.known[0].sample_time_s)
        s: Complex = np.asarray(1j * folding.omega, dtype=np.complex128)
        speed = np.concatenate([points.speed, points.speed[folding.at], points.speed[folding.at]])
        m = Matrices.of(rotor)
        now, base = _currents(rotor, points, folding)
        ki, ks = rotor.ki, rotor.ks
        force = ki * base
        excess = None
        if amplitude is not None:
            here = excess_force(ki, ks, rotor.bias_current_a, amplitude.current, amplitude.displacement)
            more = [np.concatenate([e, np.zeros((len(s) - folding.n, e.shape[1]), dtype=e.dtype)]) for e in here]
            excess = more[0], more[1], more[2]
            force = force + excess[0]
        closed = inverse_dynamics(m, ks, s, speed)
        q = np.einsum("pab,pb->pa", closed, force @ m.bearings)
        x = q @ m.bearings.T
        sensor = rotor.sensor_response(folding.omega)
        seen = sensor * (q @ m.sensors.T)
        return Motion(folding, s, speed, m, closed, q, force + ks * x, x, seen, sensor, now, base, excess)

    @property
    def coil(self) -> Complex:
        """Base-band current, (P, 4)."""
        return self.coils[: self.folding.n]

    @property
    def x(self) -> Complex:
        """Displacement at the bearings, (P, 4)."""
        return self.moved[: self.folding.n]

    @property
    def y(self) -> Complex:
        """Sampled displacement at the sensors, (P, 4)."""
        return self.folded(self.seen.copy())

    def folded(self, values: Complex) -> Complex:
        """What the sampler makes of (P + 2 K, ...), (P, ...): the same memory, see `Folding.folded`."""
        return np.moveaxis(self.folding.folded(np.moveaxis(values, 0, -1)), -1, 0)


def _currents(rotor: RotatingParameters, points: TurningPoints, folding: Folding) -> tuple[Complex, Complex]:
    """Sampled currents, (P, 4), and base-band ones, (P + 2 K, 4)."""
    now, base = np.empty_like(points.u), np.empty((len(folding.omega), points.u.shape[1]), dtype=np.complex128)
    for k, plane in enumerate(rotor.planes):
        delay, period = plane.delay_s + plane.known.computing_delay_s, plane.known.sample_time_s
        for j, place in enumerate(plane.layout.amplifiers):
            axis = 2 * k + j
            now[:, axis] = amplifier.sampled(points.omega, plane.theta[place], delay, period)[0] * points.u[:, axis]
            base[:, axis] = plane.base_band(j, folding.omega)[0] * folding.u_rows[axis]
    return now, base
