"""The rotor that turns: both planes of a rig together, coupled by gyroscopic moments, from u to i and y.

Coordinates are, per plane, the translation of the centre of gravity, the tilt, and the flexible modes of unit modal
mass; M q'' + (D + W G) q' + (K + W C - Phi_b^T Ks Phi_b) q = Phi_b^T Ki i (Genta, Dynamics of Rotating Systems, 2005,
eq. 2.14 for the tilts and chapter 3 for modes). G holds the polar inertia between the tilts, and for a mode that both
planes have, g between its two copies; C holds what damping that turns with the shaft does to them. At W = 0 the planes
fall apart, and each is `plane_model.PlaneModel`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from service.identification import amplifier
from service.identification.force_law import excess_force
from service.identification.plane_model import Amplitude, Known, Layout, PlaneModel, Prediction
from service.identification.zoh import Complex, Real

if TYPE_CHECKING:
    from service.identification.rotating_jacobian import Motion

RIGID = ("mass_kg", "transverse_inertia_kgm2", "centre_of_gravity_m")
GAINS = ("sensor_gain_xA", "sensor_gain_xB", "sensor_gain_yA", "sensor_gain_yB")
POLAR = "polar_inertia_kgm2"


@dataclass(frozen=True)
class RotatingLayout:
    """Where each parameter sits: plane x, plane y, the rigid body, sensor gains, polar inertia, couplings of modes."""

    planes: tuple[Layout, Layout]
    pairs: tuple[tuple[int, int], ...] = ()
    """(mode of x, mode of y) that are one mode of the rotor in its two planes."""

    @cached_property
    def own(self) -> tuple[slice, slice]:
        """Places of what belongs to one plane, in the order of its own layout."""
        x, y = (p.extended.start for p in self.planes)
        return slice(0, x), slice(x, x + y)

    @cached_property
    def rigid(self) -> slice:
        """Places of `RIGID`."""
        start = int(self.own[1].stop)
        return slice(start, start + 3)

    @cached_property
    def gains(self) -> slice:
        """Places of the four sensor gains."""
        return slice(self.rigid.stop, self.rigid.stop + 4)

    @property
    def polar(self) -> int:
        """Place of the polar inertia."""
        return int(self.gains.stop)

    def gyroscopic(self, pair: int) -> int:
        """Place of the gyroscopic coupling g of a pair; its circulatory coupling h follows."""
        return self.polar + 1 + 2 * pair

    @property
    def size(self) -> int:
        """Length of the parameter vector."""
        return self.polar + 1 + 2 * len(self.pairs)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each parameter."""
        names = [f"{p}_{n}" for p, layout in zip("xy", self.planes, strict=True) for n in _own_names(layout)]
        names += [*RIGID, *GAINS, POLAR]
        for k in range(len(self.pairs)):
            names += [f"pair_{k + 1}_gyroscopic", f"pair_{k + 1}_rotating_damping_rad_s"]
        return tuple(names)

    def index(self, name: str) -> int:
        """Place of a parameter by name."""
        return self.names.index(name)

    def free(self) -> NDArray[np.bool_]:
        """(size,) True for what a joint fit moves: all but the mass and the sensors' gains."""
        mask = np.ones(self.size, dtype=bool)
        mask[self.gains] = False
        mask[self.index("mass_kg")] = False
        return mask


def _own_names(layout: Layout) -> tuple[str, ...]:
    return layout.names[: layout.extended.start]


@dataclass(frozen=True)
class TurningPoints:
    """Where the model is evaluated: one row per excited point."""

    omega: Real
    """(P,) rad/s."""
    speed: Real
    """(P,) rad/s."""
    u: Complex
    """(P, 4) A."""


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


@dataclass(frozen=True)
class RotatingModel:
    """Both planes of a rig at any speed: what is known, where the parameters sit, and their values."""

    known: tuple[Known, Known]
    layout: RotatingLayout
    theta: Real
    """(size,)"""

    def at(self, theta: Real) -> RotatingModel:
        """The same rig with other parameters."""
        return replace(self, theta=theta)

    def plane(self, k: int) -> PlaneModel:
        """Plane ``k`` at standstill, 0 for x."""
        theta, layout = self.theta, self.layout
        gains = theta[layout.gains][2 * k : 2 * k + 2]
        return PlaneModel(
            self.known[k], layout.planes[k], np.concatenate([theta[layout.own[k]], theta[layout.rigid], gains])
        )

    @property
    def planes(self) -> tuple[PlaneModel, PlaneModel]:
        """Both planes at standstill."""
        return self.plane(0), self.plane(1)

    @property
    def polar_inertia(self) -> float:
        """About the shaft, kg m2."""
        return float(self.theta[self.layout.polar])

    def coupling(self, pair: int) -> tuple[float, float]:
        """Gyroscopic g, 1, and circulatory h, rad/s, of a pair: q'' + g W q' + 2 h W q between its planes."""
        at = self.layout.gyroscopic(pair)
        return float(self.theta[at]), float(self.theta[at + 1])

    @property
    def is_physical(self) -> bool:
        """Whether both planes are, and the couplings within reason."""
        gyroscopic = self.theta[self.layout.polar + 1 :: 2]
        bounded = abs(self.polar_inertia) < 3 * self.theta[self.layout.rigid][1] and np.all(np.abs(gyroscopic) < 3)
        return bool(bounded and all(p.is_physical for p in self.planes))

    def coordinate(self, plane: int, mode: int) -> int:
        """Place of a mode among the coordinates."""
        return (2 + self.layout.planes[0].n_modes) * plane + 2 + mode

    def matrices(self) -> Matrices:
        """Equations of motion of the free rotor; both tilts turn by the polar inertia, pairs of modes by g."""
        sizes = [2 + p.n_modes for p in self.layout.planes]
        n = sum(sizes)
        mass, damping, stiffness = np.ones(n), np.zeros(n), np.zeros(n)
        bearings, sensors = np.zeros((4, n)), np.zeros((4, n))
        gyroscopic, circulatory = np.zeros((n, n)), np.zeros((n, n))
        for k, plane in enumerate(self.planes):
            start, rows = k * sizes[0], slice(2 * k, 2 * k + 2)
            columns = slice(start, start + sizes[k])
            m = plane.modes
            mass[start : start + 2] = self.theta[self.layout.rigid][:2]
            damping[start + 2 : columns.stop] = 2 * m[:, 1]
            stiffness[start + 2 : columns.stop] = m[:, 0] ** 2 + m[:, 2:4] ** 2 @ plane.ks
            scale = np.sqrt(mass[start : start + 2])
            rigid_b, rigid_s = plane.rigid_shapes
            bearings[rows, columns] = np.hstack([rigid_b * scale, m[:, 2:4].T])
            sensors[rows, columns] = np.hstack([rigid_s * scale, m[:, 4:6].T])
        tilts = (1, sizes[0] + 1)
        gyroscopic[tilts], gyroscopic[tilts[::-1]] = self.polar_inertia, -self.polar_inertia
        for pair, (a, b) in enumerate(self.layout.pairs):
            x, y = self.coordinate(0, a), self.coordinate(1, b)
            g, h = self.coupling(pair)
            gyroscopic[x, y], gyroscopic[y, x] = g, -g
            circulatory[x, y], circulatory[y, x] = 2 * h, -2 * h
        return Matrices(mass, damping, stiffness, gyroscopic, circulatory, bearings, sensors)

    @property
    def ki(self) -> Real:
        """(4,) N/A."""
        return np.concatenate([p.ki for p in self.planes])

    @property
    def ks(self) -> Real:
        """(4,) N/m."""
        return np.concatenate([p.ks for p in self.planes])

    @property
    def bias_current_a(self) -> Real:
        """Bias currents, (4,) A."""
        return np.concatenate([k.bias_current_a for k in self.known])

    def sensor_response(self, omega: Real) -> Complex:
        """Gain and pole of the sensors, (P, 4)."""
        return np.hstack([p.sensor_response(omega) for p in self.planes])

    def motion(self, points: TurningPoints, amplitude: Amplitude | None) -> Motion:
        """Coordinates, forces and displacements at the points; see `predict`."""
        from service.identification.rotating_jacobian import Motion

        s: Complex = np.asarray(1j * points.omega, dtype=np.complex128)
        m = self.matrices()
        now, base = self._amplifiers(points)
        ki, ks = self.ki, self.ks
        force = ki * base
        excess = None
        if amplitude is not None:
            excess = excess_force(ki, ks, self.bias_current_a, amplitude.current, amplitude.displacement)
            force = force + excess[0]
        closed = inverse_dynamics(m, ks, s, points.speed)
        q = np.einsum("pab,pb->pa", closed, force @ m.bearings)
        x = q @ m.bearings.T
        sensor = self.sensor_response(points.omega)
        y = sensor * (q @ m.sensors.T)
        return Motion(s, points.speed, m, closed, q, force + ks * x, x, y, sensor, now, base, excess)

    def predict(self, points: TurningPoints, amplitude: Amplitude | None = None, gradient: bool = False) -> Prediction:
        """Currents and displacements at the excited lines.

        Parameters
        ----------
        points
            Frequencies, speeds and control currents.
        amplitude
            Where the force law's excess is taken, (P, 4); None for a linear magnet.
        gradient
            Whether to return the exact derivatives to every parameter.
        """
        from service.identification.rotating_jacobian import gradients

        motion = self.motion(points, amplitude)
        d_i, d_y = gradients(self, points, motion) if gradient else (None, None)
        return Prediction(motion.i, motion.y, motion.coil, motion.x, d_i, d_y)

    def _amplifiers(self, points: TurningPoints) -> tuple[Complex, Complex]:
        """Sampled and base-band currents, (P, 4) each."""
        now, base = np.empty_like(points.u), np.empty_like(points.u)
        for k, plane in enumerate(self.planes):
            delay, period = plane.delay_s + plane.known.computing_delay_s, plane.known.sample_time_s
            for j, place in enumerate(plane.layout.amplifiers):
                axis = 2 * k + j
                now[:, axis] = amplifier.sampled(points.omega, plane.theta[place], delay, period)[0] * points.u[:, axis]
                base[:, axis] = plane.base_band(j, points.omega)[0] * points.u[:, axis]
        return now, base

    def amplifier_response(self, omega: Real, base_band: bool = True) -> Complex:
        """Held amplifiers with delay, base-band or sampled, (P, 4)."""
        return np.hstack([p.amplifier_response(omega, base_band) for p in self.planes])

    def response(self, omega: Real, speed: Real | float) -> Complex:
        """Small-signal response G(s, W) from held u to sampled y, (P, 4, 4)."""
        s: Complex = np.asarray(1j * omega, dtype=np.complex128)
        m = self.matrices()
        closed = inverse_dynamics(m, self.ks, s, np.broadcast_to(np.asarray(speed, dtype=float), omega.shape))
        plant = m.sensors @ closed @ (m.bearings.T * self.ki)
        drive = self.amplifier_response(omega)
        return np.asarray(self.sensor_response(omega)[:, :, None] * plant * drive[:, None, :])


def inverse_dynamics(m: Matrices, ks: Real, s: Complex, speed: Real) -> Complex:
    """(M s^2 + (D + W G) s + K + W C - Phi_b^T Ks Phi_b)^-1, (P, n, n)."""
    n = len(m.mass)
    turning = speed[:, None, None] * (m.gyroscopic * s[:, None, None] + m.circulatory)
    dynamic = turning - m.bearings.T @ (ks[:, None] * m.bearings)
    diagonal = np.arange(n)
    dynamic[:, diagonal, diagonal] += m.mass * s[:, None] ** 2 + m.damping * s[:, None] + m.stiffness
    return np.asarray(np.linalg.inv(dynamic))


def joined(x: PlaneModel, y: PlaneModel, pairs: tuple[tuple[int, int], ...], polar_inertia: float) -> RotatingModel:
    """Two planes, identified each by itself, as one rotor that may turn; couplings of the modes are zero."""
    layout = RotatingLayout((x.layout, y.layout), pairs)
    own = [p.theta[: p.layout.extended.start] for p in (x, y)]
    rigid = 0.5 * (x.theta[x.layout.extended][:3] + y.theta[y.layout.extended][:3])
    theta = np.concatenate([*own, rigid, x.sensor_gain, y.sensor_gain, [polar_inertia], np.zeros(2 * len(pairs))])
    return RotatingModel((x.known, y.known), layout, theta)


def paired(x: PlaneModel, y: PlaneModel, relative: float = 0.05) -> tuple[tuple[int, int], ...]:
    """Modes of the two planes that are one mode of the rotor: the nearest in frequency, each once."""
    nu_x, nu_y = x.modes[:, 0], y.modes[:, 0]
    apart = np.abs(nu_x[:, None] - nu_y) / np.maximum(0.5 * (nu_x[:, None] + nu_y), 1e-12)
    pairs: list[tuple[int, int]] = []
    for place in np.argsort(apart, axis=None):
        a, b = (int(v) for v in np.unravel_index(place, apart.shape))
        if apart[a, b] < relative and all(a != i and b != j for i, j in pairs):
            pairs.append((a, b))
    return tuple(sorted(pairs))
