"""Exact derivatives of the small-signal response with respect to the datasheet's uncertain values.

With the closed mechanics Zc = M s^2 + D s + K - B R Ks Cb, coordinates q = Zc^-1 B R Ki E i and y = S Cs q, a change
of any part is a generalised force on q or a change of the sensor map, so each column costs one outer product.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.nuisance import Nuisance
from service.gap.measured.observation import Observation
from sim import actuator, amplifier, rotor, sensor
from sim.at_points import responses
from sim.rig import Amplifiers, Rig
from sim.twin import force_rotation, linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP = 1e-5
"""Relative step of central differences of closed forms (amplifiers, magnets), which are smooth to well below it."""


@dataclass(frozen=True)
class _Motion:
    """Generalised coordinates and forces of the rotor at the P points of an observation."""

    q: Complex
    """(P, q)"""
    force: Complex
    """(P, n) total bearing force"""
    y_per_push: Complex
    """(P, n, q) sensor signal per generalised force"""
    sensor: Complex
    """(P, n) sensor response"""
    s: Complex
    """(P,)"""
    receptance: Complex
    """(P, q, q) coordinates per generalised force, the magnets' stiffness closed"""


def current_jacobian(nuisance: Nuisance, rig: Rig, o: Observation) -> Complex:
    """Derivative of the fundamental of i, (P, n, 3 n), per unit of the amplifiers' values.

    Columns are gains, frequencies and dampings, axis by axis; ``rig`` is the rig at the present deviations.
    """
    n, omega, axes = rig.n_axes, 2 * np.pi * o.frequency_hz, np.arange(rig.n_axes)
    period, delay = rig.controller.sample_time_s, rig.amplifiers.delay_s + rig.controller.computing_delay_s
    early = np.exp(-1j * omega * period * rig.logging_offset_samples)[o.line, None]
    crossed = (o.U[:, o.fundamental] * early) @ rig.amplifiers.crosstalk.T
    columns = np.zeros((len(o.line), n, 3 * n), dtype=complex)
    for k, change in enumerate(
        _changes(nuisance, rig.amplifiers, lambda a: amplifier.sampled(a, omega, period, delay))
    ):
        columns[:, axes, k * n + axes] = change[o.line] * crossed
    return _per_unit(columns, nuisance.per_unit[_amplifiers(n), _amplifiers(n)])


def displacement_jacobian(nuisance: Nuisance, rig: Rig, o: Observation, amplifiers: bool = True) -> Complex:
    """Derivative of the small-signal y at the fundamental, (P, n, k), per unit of the nuisance vector.

    ``rig`` is the rig at the present deviations, effects included. Without ``amplifiers`` the columns of their values
    are zero.
    """
    rig = rig if rig.speed_rad_s == o.speed_rad_s else replace(rig, speed_rad_s=o.speed_rad_s)
    n, omega = rig.n_axes, 2 * np.pi * o.frequency_hz
    model = linear_model(rig, o.frequency_hz)
    U = o.U[:, o.fundamental]
    columns = np.zeros((len(U), n, len(nuisance)), dtype=complex)

    m, point, rotation = rotor.mechanics(rig), model.point, force_rotation(rig)
    early = np.exp(-1j * omega * rig.controller.sample_time_s * rig.logging_offset_samples)[o.line, None]
    base = responses(model.baseband, o.line, U)
    eddy = actuator.eddy_factor(rig.magnets, omega)[o.line]
    magnetic = point.ki * eddy * base * early  # (P, n) force of the current alone
    motion = _motion(rig, m, magnetic, o)
    push, at_bearing = motion.y_per_push, motion.q @ m.bearing_map.T
    lags = _gap_lags(rig, o)
    pulled = at_bearing * lags

    per_force = push @ m.force_map  # (P, n, n)
    per_magnet = per_force @ rotation
    per_current = magnetic / point.ki
    for k, (ki, ks) in enumerate(_moved_points(rig, point)):
        columns[:, :, k * n : (k + 1) * n] = per_magnet * (ki * per_current + ks * pulled)[:, None, :]
    along_turned = at_bearing @ rotor.further_along_turned_axes(rig).T
    columns[:, :, n : 2 * n] += per_magnet * (rig.magnets.ks * along_turned)[:, None, :]
    if rig.gravity_m_per_s2:  # the mass is a static load, which changes ki and ks
        ki, ks = _moved_point(lambda factor: _with_mass(rig, factor))
        columns[:, :, 6 * n] = ((ki * per_current + ks * pulled)[:, None, :] * per_magnet).sum(axis=-1)
    if amplifiers:
        delay = rig.amplifiers.delay_s + rig.controller.computing_delay_s
        late = np.exp(-1j * omega[:, None] * delay) * amplifier.hold(omega, rig.controller.sample_time_s)[:, None]
        per_base = point.ki * eddy * (U @ rig.amplifiers.crosstalk.T) * early
        changes = _changes(nuisance, rig.amplifiers, lambda a: amplifier.continuous(a, omega) * late)
        columns[:, :, _amplifiers(n)] = np.concatenate(
            [per_magnet * (per_base * change[o.line])[:, None, :] for change in changes], axis=2
        )
    axes = np.arange(n)
    columns[:, axes, 5 * n + axes] = responses(model.y_per_u, o.line, U)
    magnets = _pull(rig, point.ks * lags)
    _mechanical_columns(nuisance, rig, m, motion, magnets, columns)
    return _per_unit(columns, nuisance.per_unit)


def answer_jacobian(nuisance: Nuisance, rig: Rig, o: Observation) -> Complex:
    """Derivative of the small-signal [i, y] at the fundamental, (P, 2 n, k), per unit of the nuisance vector."""
    n = rig.n_axes
    of_current = np.zeros((len(o.line), n, len(nuisance)), dtype=complex)
    of_current[:, :, _amplifiers(n)] = current_jacobian(nuisance, rig, o)
    return np.concatenate([of_current, displacement_jacobian(nuisance, rig, o)], axis=1)


def _amplifiers(n: int) -> slice:
    """Place of gain, frequency and damping of ``n`` amplifiers in the nuisance vector; they correlate with no other."""
    return slice(2 * n, 5 * n)


def _per_unit(columns: Complex, per_unit: Real) -> Complex:
    """Physical derivatives (P, n, k) in units of the vector; one product for all points is faster than many."""
    return np.asarray((columns.reshape(-1, len(per_unit)) @ per_unit).reshape(columns.shape))


def _motion(rig: Rig, m: rotor.Mechanics, magnetic: Complex, o: Observation) -> _Motion:
    """Motion under the force of the coil currents, (P, n), before the rotation of cross-coupled magnets."""
    omega = 2 * np.pi * o.frequency_hz
    point, rotation, s = actuator.operating_point(rig), force_rotation(rig), 1j * omega
    ks = point.ks * actuator.gap_factor(rig.magnets, omega)
    stiffness = m.force_map @ (rotation * ks[:, None, :]) @ m.bearing_map
    dynamic = m.mass * s[:, None, None] ** 2 + m.damping * s[:, None, None] + (m.stiffness - stiffness)
    closed = np.asarray(np.linalg.inv(dynamic), dtype=complex)
    q = responses(closed, o.line, magnetic @ rotation.T @ m.force_map.T)
    at_bearing = q @ m.bearing_map.T
    total = (magnetic + point.ks * _gap_lags(rig, o) * at_bearing) @ rotation.T
    total = total + at_bearing @ rotor.pull_along_turned_axes(rig).T
    response = sensor.response(rig.sensors, omega)[o.line]
    push = response[:, :, None] * (m.sensor_map @ closed)[o.line]
    return _Motion(q, total, push, response, np.asarray(s[o.line]), np.asarray(closed[o.line]))


def _gap_lags(rig: Rig, o: Observation) -> Complex | Real:
    """Pull per displacement over that at rest, (P, n), or (1, n) ones."""
    lags = actuator.gap_factor(rig.magnets, 2 * np.pi * o.frequency_hz)
    return lags if len(lags) == 1 else lags[o.line]


def _pull(rig: Rig, stiffness: Complex | Real) -> Complex | Real:
    """Force of the magnets at the bearings per displacement there, (P, n, n), for each one's stiffness (P, n)."""
    pull: Complex | Real = force_rotation(rig) * stiffness[:, None, :] + rotor.pull_along_turned_axes(rig)
    return pull


@dataclass(frozen=True)
class Swing:
    """A flexible mode at the P points of an observation, in each plane."""

    coordinate: Complex
    """(P, planes) modal coordinate of the small-signal twin, m sqrt(kg)"""
    own: Complex
    """(P, planes) receptance: modal coordinate per generalised force on the mode"""
    seen: Complex
    """(P, n, planes) sensor signals per generalised force on the mode"""


def swing_of(rig: Rig, o: Observation, mode: int) -> Swing:
    """Response of the twin's flexible mode number ``mode`` to the measured control signal.

    The magnets' stiffness is closed, the controller's loop is open.
    """
    rig = rig if rig.speed_rad_s == o.speed_rad_s else replace(rig, speed_rad_s=o.speed_rad_s)
    m = rotor.mechanics(rig)
    motion = _motion(rig, m, _magnetic(rig, o), o)
    starts = np.cumsum([0, *(2 + len(plane) for plane in rig.rotor.modes[:-1])])
    at = starts + 2 + mode
    return Swing(motion.q[:, at], motion.receptance[:, at, at], motion.y_per_push[:, :, at])


def _magnetic(rig: Rig, o: Observation) -> Complex:
    """Force of the coil currents alone at each bearing, (P, n)."""
    omega = 2 * np.pi * o.frequency_hz
    base = responses(linear_model(rig, o.frequency_hz).baseband, o.line, o.U[:, o.fundamental])
    early = np.exp(-1j * omega * rig.controller.sample_time_s * rig.logging_offset_samples)[o.line, None]
    return np.asarray(
        actuator.operating_point(rig).ki * actuator.eddy_factor(rig.magnets, omega)[o.line] * base * early
    )


def residue_columns(rig: Rig, o: Observation) -> Complex:
    """Change of y per residue of one more resonance, (P, n, 2, 2), without its own 1 / (s^2 + 2 zeta w s + w^2).

    To first order in the residue, which is the same in every plane: displacement at end A or B, of bearing and sensor
    alike, per force at end A or B.
    """
    rig = rig if rig.speed_rad_s == o.speed_rad_s else replace(rig, speed_rad_s=o.speed_rad_s)
    n, m = rig.n_axes, rotor.mechanics(rig)
    point = actuator.operating_point(rig)
    motion = _motion(rig, m, _magnetic(rig, o), o)
    magnets = _pull(rig, point.ks * _gap_lags(rig, o))
    per_displacement = motion.y_per_push @ m.force_map @ magnets
    per_displacement[:, np.arange(n), np.arange(n)] += motion.sensor
    planes = (len(motion.s), n, n // 2, 2)
    force = motion.force.reshape(len(motion.s), -1, 2)
    return np.asarray(np.einsum("piva,pvb->piab", per_displacement.reshape(planes), force))


def _changes(nuisance: Nuisance, amp: Amplifiers, response: Callable[[Amplifiers], Complex]) -> list[Complex]:
    """Derivatives of a response of the amplifiers with respect to ln gain, ln frequency, ln damping, each (F, n).

    Of amplifiers without a stated damping an effect may make some with one; that is no value of the datasheet then.
    """

    def moved(name: str, factor: float) -> Complex:
        stated = getattr(nuisance.rig.amplifiers, name) is not None
        return response(replace(amp, **{name: getattr(amp, name) * factor}) if stated else amp)

    names = ("gain", "natural_frequency_rad_s", "damping_ratio")
    return [(moved(name, 1 + STEP) - moved(name, 1 - STEP)) / (2 * STEP) for name in names]


def _moved_points(rig: Rig, point: actuator.OperatingPoint) -> tuple[tuple[Real, Real], tuple[Real, Real]]:
    """Changes of (ki, ks) at the operating point, (n,) each, per ln of the nominal ki and then of the nominal ks.

    Of centred magnets without a load each changes itself alone. Else the air gap that ki and ks imply changes too, and
    with it the effect of offset and load on both.
    """
    if rig.static_current_a is None and not rig.gravity_m_per_s2 and not np.any(rig.magnets.offset_m):
        nothing = np.zeros(rig.n_axes)
        return (point.ki, nothing), (nothing, point.ks)

    def of(name: str) -> Callable[[float], Rig]:
        value = getattr(rig.magnets, name)
        return lambda factor: replace(rig, magnets=replace(rig.magnets, **{name: value * factor}))

    return _moved_point(of("ki")), _moved_point(of("ks"))


def _moved_point(moved: Callable[[float], Rig]) -> tuple[Real, Real]:
    """Changes of (ki, ks) at the operating point, (n,) each, per ln of the factor that ``moved`` applies."""
    ahead, behind = (actuator.operating_point(moved(1 + step)) for step in (STEP, -STEP))
    return (ahead.ki - behind.ki) / (2 * STEP), (ahead.ks - behind.ks) / (2 * STEP)


def _with_mass(rig: Rig, factor: float) -> Rig:
    return replace(rig, rotor=replace(rig.rotor, mass_kg=rig.rotor.mass_kg * factor))


def _mechanical_columns(
    nuisance: Nuisance, rig: Rig, m: rotor.Mechanics, motion: _Motion, magnets: Complex | Real, columns: Complex
) -> None:
    """Write the columns of mass, inertia, sensor positions and modes in place.

    ``magnets`` is the force of the magnets at the bearings per displacement there, (1, n, n) or (P, n, n).
    """
    c, r = 6 * rig.n_axes, rig.rotor
    s2, per_force = motion.s[:, None] ** 2, motion.y_per_push @ m.force_map
    per_displacement, force = per_force @ magnets, motion.force
    if rotor.sealed(rig):  # a seal acts at the bearings too, or where modes move the shaft farther
        seal = rotor.seal_stiffness(rig) + motion.s[:, None, None] * rotor.seal_damping(rig)
        at_seals = rotor.seal_map(rig, m.bearing_map)
        per_displacement = per_displacement - motion.y_per_push @ at_seals.T @ seal
        force = force - (seal @ (motion.q @ at_seals.T)[..., None])[..., 0]

    def pushed(coordinate: int, generalised_force: Complex) -> Complex:
        """Sensor signals, (P, n), of a generalised force (P, 1) on one coordinate."""
        return motion.y_per_push[:, :, coordinate] * generalised_force

    turning = rig.n_planes == 2 and bool(rig.speed_rad_s)
    start = 0
    column = c + 4
    for plane, modes in enumerate(r.modes):
        q = motion.q
        columns[:, :, c] += pushed(start, -r.mass_kg * s2 * q[:, [start]])
        columns[:, :, c + 1] += pushed(start + 1, -r.transverse_inertia_kgm2 * s2 * q[:, [start + 1]])
        for side in (0, 1):
            axis = 2 * plane + side
            columns[:, axis, c + 2 + side] += motion.sensor[:, axis] * (q @ m.sensor_slope_map[axis])
        for k, mode in enumerate(modes[: nuisance.n_modes]):
            at = start + 2 + k
            w, qk, s = mode.natural_frequency_rad_s, q[:, [at]], motion.s[:, None]
            damping = 2 * (mode.damping_ratio + mode.internal_damping_ratio) * w * s
            columns[:, :, column] = pushed(at, -(2 * w**2 + damping) * qk)
            if turning and k < len(r.modes[1 - plane]):  # circulatory stiffness of the planes' mean frequency
                other, sign = (plane + 1) % 2 * (2 + len(r.modes[0])) + 2 + k, 1.0 if plane == 0 else -1.0
                both = (mode.internal_damping_ratio + r.modes[1 - plane][k].internal_damping_ratio) / 2
                circulatory = both * w * rig.speed_rad_s
                columns[:, :, column] -= pushed(at, sign * circulatory * q[:, [other]])
                columns[:, :, column] += pushed(other, sign * circulatory * qk)
            columns[:, :, column + 1] = pushed(at, -2 * mode.damping_ratio * w * s * qk)
            for side in range(2):
                axis = 2 * plane + side
                extra = per_displacement[:, :, axis] * qk
                columns[:, :, column + 2 + side] = pushed(at, force[:, [axis]]) + extra
                columns[:, axis, column + 4 + side] = motion.sensor[:, axis] * qk[:, 0]
            column += 6
        start += 2 + len(modes)


def stacked(x: Complex) -> Real:
    """(..., columns) complex -> (2 rows, columns): real parts, then imaginary ones."""
    flat = x.reshape(int(np.prod(x.shape[:-1])), x.shape[-1])
    return np.concatenate([flat.real, flat.imag])
