"""Rotor and support: parameters -> M q'' + (D + G) q' + K q = B f, with the exact maps to bearings and sensors.

Coordinates: per plane the translation of the centre of gravity, the tilt, and the flexible modes (free-free,
unit modal mass); then, where the rig has a support, one displacement per plane of each housing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from sim import actuator
from sim.rig import Array, Rig

Complex = NDArray[np.complex128]


LEAST_SHARE = 1e-12
"""Share of a housing's inverse mass below which there is none: its mass would leave the range of numbers."""


@dataclass(frozen=True)
class Mechanics:
    """Second-order equations of rotor and support, q coordinates and n axes."""

    mass: Array
    """(q, q)"""
    damping: Array
    """(q, q), gyroscopic terms included"""
    stiffness: Array
    """(q, q), circulatory terms included"""
    force_map: Array
    """(q, n) bearing forces -> generalised forces, reaction on the housing included"""
    bearing_map: Array
    """(n, q) -> displacement at the bearings, relative to the housing"""
    sensor_map: Array
    """(n, q) -> displacement at the sensors, relative to the housing"""
    sensor_slope_map: Array
    """(n, q) change of ``sensor_map`` per metre that a sensor is farther from the centre of gravity; none of modes"""

    @property
    def high_frequency(self) -> Array:
        """C_sensor M^-1 B, (n, n): the receptance tends to -this / w^2."""
        return self.sensor_map @ np.linalg.solve(self.mass, self.force_map)


def plane_maps(rig: Rig, plane: int) -> tuple[Array, Array]:
    """Displacement at bearings and at sensors per coordinate of one plane, each (2, 2 + modes)."""
    rotor = rig.rotor
    modes = rotor.modes[plane]
    (a, b), (sa, sb) = rotor.bearing_from_cog_m, rotor.sensor_from_cog_m
    bearings = np.array([[1.0, 1.0], [a, -b], *(m.shape_at_bearings for m in modes)])
    sensors = np.array([[1.0, 1.0], [sa, -sb], *(m.shape_at_sensors for m in modes)])
    return bearings.T, sensors.T


def mechanics(rig: Rig) -> Mechanics:
    """Equations of motion of rotor and support at the rig's speed.

    The gyroscopic moment couples the tilts of the two planes, Ip W (Genta, Dynamics of Rotating Systems, 2005,
    eq. 2.14), that of a disc those of modes too, as its own tilt is the sum of theirs (chapter 4); internal damping
    adds the circulatory stiffness zi w1 W x 2 that makes forward whirl lose damping.
    """
    rotor, n, speed = rig.rotor, rig.n_axes, rig.speed_rad_s
    sizes = [2 + len(m) for m in rotor.modes]
    *starts, n_rotor = accumulate(sizes, initial=0)
    housings = [h for plane in range(rig.n_planes) for h in _housings(rig, plane)]
    n_q = n_rotor + len(housings)
    mass, damping, stiffness = np.zeros((n_q, n_q)), np.zeros((n_q, n_q)), np.zeros((n_q, n_q))
    bearing_map, sensor_map, sensor_slope_map = (np.zeros((n, n_q)) for _ in range(3))
    for plane, modes in enumerate(rotor.modes):
        s, rows = starts[plane], slice(2 * plane, 2 * plane + 2)
        columns = slice(s, s + sizes[plane])
        mass[s, s], mass[s + 1, s + 1] = rotor.mass_kg, rotor.transverse_inertia_kgm2
        for k, m in enumerate(modes, start=s + 2):
            w, internal = m.natural_frequency_rad_s, m.internal_damping_ratio
            mass[k, k], stiffness[k, k] = 1.0, w**2
            damping[k, k] = 2 * (m.damping_ratio + internal) * w
        bearing_map[rows, columns], sensor_map[rows, columns] = plane_maps(rig, plane)
        sensor_slope_map[rows, s + 1] = 1.0, -1.0
    if rig.n_planes == 2 and speed:
        _turning(rig, starts, damping, stiffness)
    for k, housing in enumerate(housings, start=n_rotor):
        mass[k, k], damping[k, k], stiffness[k, k] = housing.inertia
        bearing_map[housing.axes, k], sensor_map[housing.axes, k] = -housing.at_bearings, -housing.at_sensors
        sensor_slope_map[housing.axes, k] = -housing.sensor_slope
    if sealed(rig):
        at_seals = seal_map(rig, bearing_map)
        stiffness += at_seals.T @ seal_stiffness(rig) @ at_seals
        damping += at_seals.T @ seal_damping(rig) @ at_seals
    if rig.magnets.turned_whole:
        stiffness -= bearing_map.T @ pull_along_turned_axes(rig) @ bearing_map
    return Mechanics(mass, damping, stiffness, bearing_map.T.copy(), bearing_map, sensor_map, sensor_slope_map)


def sealed(rig: Rig) -> bool:
    """Whether seals act on a rig of two planes, at its speed."""
    return rig.n_planes == 2 and bool(np.any(_cross_stiffness(rig)) or np.any(_direct_damping(rig)))


def seal_map(rig: Rig, bearing_map: Array) -> Array:
    """Displacement at the bearings, as seals meet it, per generalised coordinate, (4, n_q).

    Between the bearings a mode moves the shaft farther than a straight line through both, or the other way.
    """
    out, start = bearing_map.copy(), 2
    for plane, modes in enumerate(rig.rotor.modes):
        bows = rig.seal_bow_per_sqrt_kg[: len(modes)]
        out[2 * plane : 2 * plane + 2, start : start + len(bows)] += bows
        start += 2 + len(modes)
    return out


def seal_stiffness(rig: Rig) -> Array:
    """Stiffness of seals at the bearings of two planes, (4, 4): fx = -k y, fy = +k x on the right-hand side."""
    return np.kron(np.array([[0.0, 1.0], [-1.0, 0.0]]), _cross_stiffness(rig))


def seal_damping(rig: Rig) -> Array:
    """Damping of seals at the bearings of two planes, (4, 4), on the right-hand side as their stiffness."""
    return np.asarray(np.kron(np.eye(2), _direct_damping(rig)))


def further_along_turned_axes(rig: Rig) -> Array:
    """What magnets that are turned as a whole meet of a displacement beside what others do, w (R^T - 1), (n, n).

    R is the rotation of the forces, w the share that is turned as a whole: a magnet meets the displacement along its
    own axis.
    """
    return np.asarray(rig.magnets.turned_whole * (actuator.force_rotation(rig).T - np.eye(rig.n_axes)))


def pull_along_turned_axes(rig: Rig) -> Array:
    """What they pull more with displacement than turned forces do, w (R ks R^T - R ks), N/m, (n, n)."""
    return np.asarray(actuator.force_rotation(rig) * rig.magnets.ks @ further_along_turned_axes(rig))


def _cross_stiffness(rig: Rig) -> Array:
    """K of the seals at the rig's speed, N/m, (2, 2)."""
    return rig.seal_cross_stiffness_n_per_m + rig.seal_cross_stiffness_by_speed_ns_per_m * rig.speed_rad_s


def _direct_damping(rig: Rig) -> Array:
    """C of the seals at the rig's speed, N s/m, (2, 2); a rotor at rest carries no fluid round."""
    if not rig.speed_rad_s:
        return np.zeros((2, 2))
    return rig.seal_damping_ns_per_m + rig.seal_damping_times_speed_n_per_m / abs(rig.speed_rad_s)


@dataclass(frozen=True)
class _Housing:
    """A coordinate in which something that carries bearings of a plane moves."""

    axes: NDArray[np.int64]
    """whose bearings it carries"""
    at_bearings: Array
    """their displacement per unit, (len(axes),)"""
    at_sensors: Array
    """that of their sensors, (len(axes),)"""
    sensor_slope: Array
    """what that is more per metre that they are farther from the centre of gravity, 1/m, (len(axes),)"""
    inertia: tuple[float, float, float]
    """mass, damping and stiffness"""


def _housings(rig: Rig, plane: int) -> list[_Housing]:
    """What carries the bearings of a plane: a housing that translates or leans, and rocks; a pedestal under each."""
    if (support := rig.support) is None:
        return []
    share, w = support.pedestals, support.natural_frequency_rad_s * support.plane_frequency_ratio**plane
    zeta, zeta_b = support.damping_ratio, support.damping_ratio * support.damping_quotient
    a, b = 2 * plane, 2 * plane + 1
    of_a, of_b = support.of_axis(a), support.of_axis(b)
    mean = (of_a + of_b) / 2
    lean = np.sqrt(np.array([of_a, of_b]) / mean) if mean > LEAST_SHARE else np.ones(2)
    of_both = (1 - share) * mean
    slopes = np.array([1.0, -1.0]) / (sum(rig.rotor.bearing_from_cog_m) / 2)
    bearings = np.array([1.0, -1.0]) + support.rocking_imbalance
    sensors = bearings + slopes * np.subtract(rig.rotor.sensor_from_cog_m, rig.rotor.bearing_from_cog_m)
    one = np.ones(1)
    translating = ([a, b], (lean, lean, 0 * lean), of_both, w, zeta)
    rocking = (
        [a, b],
        (bearings, sensors, slopes),
        support.rocking * of_both,
        w * support.rocking_frequency_ratio * support.rocking_plane_quotient**plane,
        zeta * support.rocking_damping_quotient,
    )
    under_a = ([a], (one, one, 0 * one), share * of_a, w, zeta)
    under_b = ([b], (one, one, 0 * one), share * of_b, w * support.frequency_ratio, zeta_b)
    out = []
    for axes, (at_bearings, at_sensors, slope), part, own, damping in (translating, rocking, under_a, under_b):
        if part > LEAST_SHARE:
            mass = support.mass_kg / part
            inertia = (mass, 2 * damping * own * mass, mass * own**2)
            out.append(_Housing(np.array(axes), at_bearings, at_sensors, slope, inertia))
    return out


def _turning(rig: Rig, starts: Sequence[int], damping: Array, stiffness: Array) -> None:
    """Gyroscopic and circulatory coupling of the two planes at speed, added in place."""
    rotor, speed = rig.rotor, rig.speed_rad_s
    x, y = starts[0] + 1, starts[1] + 1
    for disc in rotor.discs:
        tilts = np.zeros(1 + min(map(len, rotor.modes)))
        slopes = (1.0, *disc.slopes_per_m_sqrt_kg)[: len(tilts)]
        tilts[: len(slopes)] = slopes
        moment = disc.polar_inertia_kgm2 * speed * np.outer(tilts, tilts)
        of_x, of_y = slice(x, x + len(tilts)), slice(y, y + len(tilts))
        damping[of_x, of_y] += moment
        damping[of_y, of_x] -= moment
    damping[x, y] += rotor.polar_inertia_kgm2 * speed
    damping[y, x] -= rotor.polar_inertia_kgm2 * speed
    for j, k, g in rotor.gyroscopic_between:
        for in_x, in_y in ((x + 1 + j, y + 1 + k), (x + 1 + k, y + 1 + j)):
            damping[in_x, in_y] += g * speed
            damping[in_y, in_x] -= g * speed
    for mx, my in zip(rotor.modes[0], rotor.modes[1], strict=True):
        x, y = x + 1, y + 1
        gyroscopic = 0.5 * (mx.gyroscopic + my.gyroscopic) * speed
        damping[x, y] += gyroscopic
        damping[y, x] -= gyroscopic
        w = 0.5 * (mx.natural_frequency_rad_s + my.natural_frequency_rad_s)
        circulatory = (mx.internal_damping_ratio + my.internal_damping_ratio) * w * speed
        stiffness[x, y] += circulatory
        stiffness[y, x] -= circulatory


def receptances(m: Mechanics, omega_rad_s: Array) -> tuple[Complex, Complex]:
    """Displacement at bearings and at sensors per bearing force, each (F, n, n), m/N, for the free rotor.

    Modal sums where the matrices are diagonal (no support coupling by inertia, no turning), a solve otherwise.
    """
    s = 1j * np.asarray(omega_rad_s, dtype=float)
    diagonal = all(np.count_nonzero(a) == np.count_nonzero(a.diagonal()) for a in (m.mass, m.damping, m.stiffness))
    if diagonal:
        dynamic = m.mass.diagonal() * s[:, None] ** 2 + m.damping.diagonal() * s[:, None] + m.stiffness.diagonal()
        n = m.bearing_map.shape[0]
        maps = np.concatenate([m.bearing_map, m.sensor_map]).T[:, :, None] * m.force_map[:, None, :]  # (q, 2 n, n)
        both = ((1 / dynamic) @ maps.reshape(len(maps), -1)).reshape(len(s), 2, n, n)
        return both[:, 0], both[:, 1]
    full = m.mass * s[:, None, None] ** 2 + m.damping * s[:, None, None] + m.stiffness
    q = np.linalg.solve(full, np.broadcast_to(m.force_map + 0j, (len(s), *m.force_map.shape)))
    return np.asarray(m.bearing_map @ q), np.asarray(m.sensor_map @ q)
