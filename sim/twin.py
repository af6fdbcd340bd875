"""The twin: datasheet and effects -> one rig, its linear frequency responses and its loop.

>>> import numpy as np
>>> from sim.reference import reference_rig
>>> model = linear_model(reference_rig(), np.array([100.0]))
>>> model.y_per_u.shape
(1, 4, 4)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim import actuator, amplifier, control_law, rotor, sensor
from sim.actuator import OperatingPoint
from sim.actuator import force_rotation as force_rotation
from sim.datasheet import Datasheet
from sim.remember import remembered
from sim.rig import (
    Amplifiers,
    Array,
    ControlLaw,
    FlexibleMode,
    Magnets,
    Rig,
    Rotor,
    Sensors,
)

Complex = NDArray[np.complex128]


def non_rotating(datasheet: Datasheet) -> Datasheet:
    """The datasheet as its twin is: without gyroscopic moment, whatever polar inertia it states.

    A twin that names gyroscopic coupling turns, with the polar inertia that is stated beside it.
    """
    turns = any(name == "gyroscopic_coupling" for name, _ in datasheet.effects)
    return datasheet if turns else replace(datasheet, polar_inertia_kgm2=None)


def rig_from_datasheet(datasheet: Datasheet) -> Rig:
    """The rig that a datasheet describes: at standstill, without noise, with the effects that it names.

    Raises
    ------
    EffectError
        An unknown effect or parameter.
    """
    d, n = datasheet, datasheet.n_axes
    modes = tuple(
        FlexibleMode(2 * math.pi * m.frequency_hz, m.damping_ratio, m.shape_at_bearings, m.shape_at_sensors)
        for m in d.modes
    )
    bandwidth = np.full(n, np.inf) if d.sensor_bandwidth_hz is None else 2 * np.pi * np.array(d.sensor_bandwidth_hz)
    rig = Rig(
        name=d.name,
        axes=d.axes,
        rotor=Rotor(
            d.mass_kg,
            d.transverse_inertia_kgm2,
            d.polar_inertia_kgm2 or 0.0,
            d.bearing_from_cog_m,
            d.sensor_from_cog_m,
            (modes,) * (n // 2),
        ),
        magnets=Magnets.plain(
            ki=np.array(d.current_stiffness_n_per_a),
            ks=np.array(d.position_stiffness_n_per_m),
            bias_current_a=np.array(d.bias_current_a),
            current_limit_a=d.current_limit_a,
        ),
        amplifiers=Amplifiers.plain(
            gain=np.array(d.amplifier_gain),
            natural_frequency_rad_s=2 * np.pi * np.array(d.amplifier_natural_frequency_hz),
            damping_ratio=None if d.amplifier_damping_ratio is None else np.array(d.amplifier_damping_ratio),
        ),
        sensors=Sensors(np.array(d.sensor_gain), bandwidth, np.zeros(n), np.zeros(n)),
        controller=ControlLaw(np.array(d.numerator), np.array(d.denominator), d.sample_time_s, d.computing_delay_s),
        displacement_limit_m=d.displacement_limit_m,
        current_limit_a=d.current_limit_a,
        linear_range_m=d.linear_range_m,
    )
    return with_effects(rig, {k: dict(v) for k, v in d.effects})


def with_effects(rig: Rig, effects: Mapping[str, Mapping[str, float]]) -> Rig:
    """Rig with effects of the catalogue added, in order; parameters not given keep their typical values.

    Raises
    ------
    EffectError
        An unknown effect or parameter, or one that this rig cannot have.
    """
    from sim.effects import effect  # the catalogue's files import the parts of a rig, so it is read late

    for name, values in effects.items():
        rig = effect(name).on(rig, **values)
    return rig


@dataclass(frozen=True, kw_only=True)
class LinearModel:
    """Small-signal responses of a rig at F frequencies; matrices are (F, output, input).

    What few ask for is computed when it is first asked for, and kept.
    """

    rig: Rig
    point: OperatingPoint
    """Where the magnets work, and their factors there."""
    omega_rad_s: Array
    y_per_u: Complex
    """Sampled sensor signal per held control signal, m/A."""
    y_per_force: Complex
    """Sensor signal per force at the bearings, the magnets' stiffness closed, m/N."""
    bearing_per_force: Complex
    """Displacement at the bearings per force there, the magnets' stiffness closed, m/N."""
    held: Complex
    """Component at the excited frequency of each axis's coil current (not its samples) per control signal that
    crosstalk has mixed, A/A, (F, n)."""
    flux: Complex
    """Current that makes flux per coil current, after eddy currents, (F, n)."""
    log_phase: Complex
    """exp(-j w T n) of a log whose u is n samples early, in ``i_per_u`` and ``y_per_u``, (F,)."""

    @cached_property
    def plant(self) -> Complex:
        """Continuous y per coil current, m/A."""
        per_current = _mixed(self.y_per_force, force_rotation(self.rig)) * (self.point.ki * self.flux)[:, None, :]
        return _shared(per_current)

    @cached_property
    def baseband(self) -> Complex:
        """Component of the coil current at the excited frequency (not its samples) per u, A/A."""
        return _shared(self.held[:, :, None] * self.rig.amplifiers.crosstalk)

    @cached_property
    def flux_per_u(self) -> Complex:
        """Component at the excited frequency of the current that makes flux, after eddy currents, per u, A/A."""
        return _shared(self.flux[:, :, None] * self.baseband)

    @cached_property
    def bearing_per_u(self) -> Complex:
        """Displacement at the bearings, relative to the housing, per u, m/A."""
        per_control = (self.point.ki * self.flux * self.held)[:, None, :]
        per_magnet = _mixed(self.bearing_per_force, force_rotation(self.rig))
        return _shared(_mixed(per_magnet * per_control, self.rig.amplifiers.crosstalk))

    @cached_property
    def controllers(self) -> Complex:
        """C from -y to u of each axis, (F, n)."""
        return _shared(control_law.responses(self.rig.controller, self.omega_rad_s, self.rig.n_axes))

    @property
    def controller(self) -> Complex:
        """C from -y to u where all axes have the same, else the mean of theirs, (F,)."""
        return np.asarray(self.controllers.mean(axis=1))

    @cached_property
    def i_per_u(self) -> Complex:
        """Sampled coil current per held control signal, A/A."""
        return _shared(current_per_control(self.rig, self.omega_rad_s / (2 * np.pi)))

    @property
    def y_per_i(self) -> Complex:
        """What an ETFE from logged i to logged y sees."""
        return np.asarray(np.swapaxes(np.linalg.solve(_transposed(self.i_per_u), _transposed(self.y_per_u)), -1, -2))

    @property
    def sensitivity(self) -> Complex:
        """(I + C G)^-1, G from the u and y that are logged; u per r where the log is right."""
        n = self.y_per_u.shape[-1]
        return np.asarray(np.linalg.inv(np.eye(n) + self.controllers[:, :, None] * self.y_per_u))

    @property
    def u_per_r(self) -> Complex:
        """Logged u per r of the loop that runs, whatever the log: its size is the sensitivity of that loop."""
        n = self.y_per_u.shape[-1]
        loop = self.log_phase[:, None, None] * np.eye(n) + self.controllers[:, :, None] * self.y_per_u
        return np.asarray(np.linalg.inv(loop))


def _shared(response: Complex) -> Complex:
    """Read-only, as the model that it is of is remembered."""
    response.flags.writeable = False
    return response


def _transposed(a: Complex) -> Complex:
    return np.swapaxes(a, -1, -2)


def current_per_control(rig: Rig, frequency_hz: Array) -> Complex:
    """Sampled coil current per held, logged control signal, A/A, (F, n, n): `LinearModel.i_per_u` alone."""
    return np.asarray(axis_current_per_control(rig, frequency_hz)[:, :, None] * rig.amplifiers.crosstalk)


def axis_current_per_control(rig: Rig, frequency_hz: Array) -> Complex:
    """The same of each axis's own amplifier, (F, n), for the control signal that crosstalk has mixed."""
    omega, period = 2 * np.pi * np.asarray(frequency_hz, dtype=float), rig.controller.sample_time_s
    delay = rig.amplifiers.delay_s + rig.controller.computing_delay_s
    own = amplifier.sampled(rig.amplifiers, omega, period, delay)
    if not rig.logging_offset_samples:
        return own
    return np.asarray(own * np.exp(-1j * omega * period * rig.logging_offset_samples)[:, None])


def small_signal(rig: Rig) -> Rig:
    """The rig without what small signals do not meet, so that rigs which differ in that alone share a `linear_model`.

    Saturation counts where the magnets carry a load, or sit off their centre.
    """
    m, unlimited = rig.magnets, np.full(rig.n_axes, np.inf)
    if rig.contact is not None or rig.drift is not None:
        rig = replace(rig, contact=None, drift=None)
    if np.any(np.isfinite(rig.amplifiers.slew_limit_a_per_s)):
        free = replace(rig.amplifiers, slew_limit_a_per_s=unlimited, slew_seen=0.0, slope_noise_share=0.0)
        rig = replace(rig, amplifiers=free)
    bent: dict[str, Any] = {}
    if np.any(m.hysteresis_rad):
        bent |= {"hysteresis_rad": np.zeros(rig.n_axes)}
        bent |= {
            "hysteresis_narrowest_a": 0.0,
            "hysteresis_widest_inverse_per_a": 0.0,
            "hysteresis_density": (),
            "hysteresis_displacement_share": 0.0,
        }
    centred = not rig.gravity_m_per_s2 and rig.static_current_a is None and not np.any(m.offset_m)
    if centred and np.any(np.isfinite(m.saturation_current_a)):
        bent |= {"saturation_current_a": unlimited}
    return replace(rig, magnets=replace(m, **bent)) if bent else rig


@remembered(16)
def linear_model(rig: Rig, frequency_hz: Array) -> LinearModel:
    """Exact small-signal responses of the sampled rig, at its operating point.

    u is held between samples; i and y are taken at the samples. The current's samples carry the hold's images,
    so they come from the sampled amplifier; the displacement sees the baseband current and, at its roll-off of
    40 dB a decade more, the first pair of images with the receptance's high-frequency limit.
    """
    return passing_model(rig, frequency_hz)


def passing_model(rig: Rig, frequency_hz: Array) -> LinearModel:
    """`linear_model` of a rig that is asked for once: to read and keep it would take a third as long again."""
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
    period = rig.controller.sample_time_s
    delay = rig.amplifiers.delay_s + rig.controller.computing_delay_s
    mechanics = rotor.mechanics(rig)
    at_bearings, at_sensors = rotor.receptances(mechanics, omega)
    point, rotation, n = actuator.operating_point(rig), force_rotation(rig), rig.n_axes
    w = omega + 2 * np.pi / period * np.array([[0.0], [-1.0], [1.0]])  # the tone and its first images, (3, F)
    own, eddy, seen = (
        x.reshape(*w.shape, n)
        for x in (
            _held(rig.amplifiers, period, delay, w.ravel()),
            actuator.eddy_factor(rig.magnets, w.ravel()),
            sensor.response(rig.sensors, w.ravel()),
        )
    )
    # An axis's own factors scale columns; to mix axes takes a product of matrices, left out where nothing is mixed.
    per_current = point.ki * eddy  # force per baseband current, before it is turned
    per_control = per_current * own

    stiffness = _mixed_from(rotation, (point.ks * actuator.gap_factor(rig.magnets, omega))[..., None] * at_bearings)
    closed = np.linalg.inv(np.eye(n) - stiffness)  # all bearing force per external force
    y_per_force = seen[0, :, :, None] * (at_sensors @ closed)
    y_per_magnet = _mixed(y_per_force, rotation)
    y_per_u = y_per_magnet * per_control[0, :, None, :]
    limit = mechanics.high_frequency @ rotation
    for k in (1, 2):
        gain = seen[k] / -(w[k] ** 2)[:, None]
        y_per_u += limit * gain[:, :, None] * per_control[k, :, None, :]
    logged_early = np.exp(-1j * omega * period * rig.logging_offset_samples)
    return LinearModel(
        rig=rig,
        point=point,
        omega_rad_s=omega,
        y_per_u=_mixed(y_per_u, rig.amplifiers.crosstalk) * logged_early[:, None, None],
        y_per_force=y_per_force,
        bearing_per_force=at_bearings @ closed,
        held=own[0],
        flux=eddy[0],
        log_phase=logged_early,
    )


@remembered(32)
def _held(amplifiers: Amplifiers, sample_time_s: float, delay_s: Array, omega_rad_s: Array) -> Complex:
    """Component at a frequency of each axis's coil current per held control signal, without crosstalk, (F, n)."""
    late = np.exp(-1j * omega_rad_s[:, None] * delay_s) * amplifier.hold(omega_rad_s, sample_time_s)[:, None]
    return np.asarray(amplifier.continuous(amplifiers, omega_rad_s) * late)


def _mixed(matrices: Complex, by: Array) -> Complex:
    """``matrices`` (F, a, n) times one matrix (n, n) that is mostly the identity."""
    if _is_identity(by):
        return matrices
    # as one product: numpy would make one of every matrix, six times as slow
    return np.asarray((matrices.reshape(-1, matrices.shape[-1]) @ by).reshape(matrices.shape))


def _mixed_from(by: Array, matrices: Complex) -> Complex:
    """One matrix (n, n) that is mostly the identity times ``matrices`` (F, n, a)."""
    return matrices if _is_identity(by) else np.asarray(by @ matrices)


_EYES = {n: np.eye(n) for n in (1, 2, 4)}


def _is_identity(matrix: Array) -> bool:
    return bool((matrix == _EYES[len(matrix)]).all())
