"""Harmonic balance: what a rig answers to a known periodic control signal, harmonics 0 to 3.

The linear part is exact per harmonic (`sim.twin.linear_model`); the nonlinear part (the magnets' law,
saturation, hysteresis, contact, the supply's voltage limit) is evaluated in time over one period and fed back
as forces, the alternating frequency/time method (Cameron and Griffin, J. Appl. Mech. 56, 1989). The rig is
weakly nonlinear, so a few rounds converge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import overload

import numpy as np

from sim import amplifier, magnetic_force, sensor, slew_limit
from sim.actuator import OperatingPoint
from sim.alternating import Complex, Index, amplitudes, period_samples
from sim.rig import Array, Rig
from sim.twin import LinearModel, linear_model

RESPONSE = (0, 1, 2, 3)
"""Harmonics with which the force answers, whether or not they were logged: the mean and the second one of an
off-centre rotor bend its fundamental, too."""
STATIC_HZ = 1e-2
"""Frequency at which the static response (harmonic 0) is evaluated: far below every pole of an AMB rig."""


@dataclass(frozen=True)
class Answer:
    """Coil current and sensor signal, complex amplitudes, each (P, H, n)."""

    I: Complex
    Y: Complex


def _times(matrices: Complex, x: Complex) -> Complex:
    """Matrices (P, H, a, b) times amplitudes (P, H, b) -> (P, H, a)."""
    return np.asarray((matrices @ x[..., None])[..., 0])


class Responder:
    """A rig made ready to answer at given frequencies; the excitation may then differ from call to call.

    Parameters
    ----------
    rig : Rig
    frequency_hz : (F,) distinct excited frequencies
    line : (P,) index of each point's frequency
    harmonics : those of the signals, ascending, 1 among them. Of `RESPONSE`, those that are not among them are what
        the rig's own controller lets happen: the force has them all the same, and the rotor moves with it
    progress : (P,) share of the campaign at which each point was measured, for rigs that drift
    """

    def __init__(
        self,
        rig: Rig,
        frequency_hz: Array,
        line: Index,
        harmonics: tuple[int, ...] = (0, 1, 2, 3),
        progress: Array | None = None,
    ) -> None:
        self.rig, self.line = rig, line
        self.harmonics = tuple(sorted({*harmonics, *RESPONSE}))
        self._known = [self.harmonics.index(h) for h in harmonics]
        self._unknown = [k for k, h in enumerate(self.harmonics) if h not in harmonics]
        self.progress = progress
        grid = np.concatenate([np.maximum(h * frequency_hz, STATIC_HZ) for h in self.harmonics])
        self._omega = 2 * np.pi * grid
        # The rig itself does not know of an offset of its log: the logged control signal is put right first.
        ran = replace(rig, logging_offset_samples=0.0) if rig.logging_offset_samples else rig
        self._model: LinearModel = linear_model(ran, grid)
        self._point: OperatingPoint = self._model.point
        late = np.exp(-1j * self._omega * rig.controller.sample_time_s * rig.logging_offset_samples)
        self._log_phase: Complex = late.reshape(len(self.harmonics), -1)[:, line].T[..., None]  # (P, H, 1)
        self._strongly = bool(
            np.any(rig.magnets.hysteresis_rad > 0)
            or rig.contact
            or np.any(np.isfinite(rig.magnets.saturation_current_a))
            or np.any(rig.magnets.flux_share)
        )
        self._slews = bool(np.any(np.isfinite(rig.amplifiers.slew_limit_a_per_s)))

    def _of_points(self, matrices: Complex) -> Complex:
        """Matrices of each harmonic's lines, (H F, a, b) -> those of the points, (P, H, a, b)."""
        per_harmonic = matrices.reshape(len(self.harmonics), -1, *matrices.shape[1:])
        return np.asarray(per_harmonic.swapaxes(0, 1)[self.line])

    def _at_points(self, matrices: Complex, x: Complex) -> Complex:
        """Matrices of each harmonic's lines, (H F, a, b), times amplitudes (P, H, b) -> (P, H, a)."""
        return _times(self._of_points(matrices), x)

    def answer(
        self, U: Complex, rounds: int | None = None, seen: Complex | None = None, seen_current: Complex | None = None
    ) -> Answer:
        """Response to logged control amplitudes U, (P, H, n), harmonics as given to the constructor.

        Parameters
        ----------
        seen
            (P, H, n) measured sensor signal. The magnets alone make an unstable plant, so for a given U a strong
            nonlinear force feeds on itself; evaluated where the rotor was seen to be, it does not.
        seen_current
            (P, H, n) measured coil current: as `current`.
        """
        current, effective = self._current(self._effective(U), self._whole(seen_current))
        return Answer(current[:, self._known], self._displacement(effective, rounds, self._whole(seen)))

    def displacement(
        self, U: Complex, rounds: int | None = None, seen: Complex | None = None, seen_current: Complex | None = None
    ) -> Complex:
        """Sensor signal of `answer` alone, (P, H, n), which takes half the time."""
        effective = self._effective(U)
        if self._slews:
            effective = self._current(effective, self._whole(seen_current))[1]
        return self._displacement(effective, rounds, self._whole(seen))

    def current(self, U: Complex, seen: Complex | None = None) -> Complex:
        """Sampled coil current for logged control amplitudes U, (P, H, n): the amplifiers alone.

        An amplifier beyond its slew limit may answer in two ways: the one nearer to ``seen`` (P, H, n) where that is
        given, else the one that a rising amplitude leads to.
        """
        return self._current(self._effective(U), self._whole(seen))[0][:, self._known]

    def _effective(self, U: Complex) -> Complex:
        """Control signal that ran, all harmonics, of the logged one, (P, H, n): 0 where none was logged."""
        return self._whole(U) * self._log_phase

    @overload
    def _whole(self, X: Complex) -> Complex: ...

    @overload
    def _whole(self, X: Complex | None) -> Complex | None: ...

    def _whole(self, X: Complex | None) -> Complex | None:
        """A signal with 0 in the harmonics that were not logged."""
        if X is None or not self._unknown:
            return X
        whole = np.zeros((X.shape[0], len(self.harmonics), X.shape[2]), dtype=complex)
        whole[:, self._known] = X
        return whole

    def _fed_back(self, sensed: Complex) -> tuple[Complex, Complex, Complex]:
        """Displacements at bearings and sensors, and control signal, per force, of harmonics that were not logged.

        With the controller closed, (P, H, n, n) each: logged signals hold by themselves what it does.
        """
        m, k = self._model, self._unknown
        H, n = len(self.harmonics), sensed.shape[-1]
        omega = self._omega.reshape(H, -1)[:, self.line].T[:, k]
        C = m.controller.reshape(H, -1)[:, self.line].T[:, k]
        C = np.where(omega * self.rig.controller.sample_time_s < np.pi, C, 0.0)[..., None, None]
        y = np.linalg.solve(np.eye(n) + C * self._of_points(m.y_per_u)[:, k], sensed[:, k])
        u = -C * y
        x = self._of_points(m.bearing_per_force)[:, k] + self._of_points(m.bearing_per_u)[:, k] @ u
        return np.asarray(x), np.asarray(y), np.asarray(u)

    def _displacement(self, U: Complex, rounds: int | None, seen: Complex | None) -> Complex:
        """Sensor signal, (P, H, n), for the control signal that a linear amplifier would need."""
        m = self._model
        x_linear, Y_linear = self._at_points(m.bearing_per_u, U), self._at_points(m.y_per_u, U)
        bearing, sensed = self._of_points(m.bearing_per_force), self._of_points(m.y_per_force)
        drawn, fed = self._drawn(self._at_points(m.flux_per_u, U)), None
        if self._unknown:
            fed = np.zeros_like(sensed)
            bearing[:, self._unknown], sensed[:, self._unknown], fed[:, self._unknown] = self._fed_back(sensed)

        def force_at(x: Complex, Y: Complex) -> Complex:
            return self._beyond_linear(drawn, x if seen is None else x + self._from_sensors(seen - Y))

        force = force_at(x_linear, Y_linear)
        for _ in range((rounds or (3 if seen is not None else 6 if self._strongly else 3)) - 1):
            if fed is not None:
                drawn = self._drawn(self._at_points(m.flux_per_u, U + _times(fed, force)))
            force = force_at(x_linear + _times(bearing, force), Y_linear + _times(sensed, force))
        return self._static_real(Y_linear + _times(sensed, force))[:, self._known]

    def _from_sensors(self, Y: Complex) -> Complex:
        """Displacement at the bearings, (P, H, n), of a rigid rotor that the sensors see at Y.

        It corrects a displacement that the model has but for the force in question, so flexibility may be left out;
        the mean is left to the model, as no sensor knows its own zero, and so is what was not logged.
        """
        own, to_bearings = self._sensed
        at_sensor = Y * own
        at_sensor[:, [0, *self._unknown]] = 0.0
        # as one product: numpy would make one of every point's, six times as slow
        return np.asarray((at_sensor.reshape(-1, len(to_bearings)) @ to_bearings).reshape(at_sensor.shape))

    @cached_property
    def _sensed(self) -> tuple[Complex, Array]:
        """Displacement per signal of each sensor, (P, H, n), and displacements at the sensors -> at the bearings."""
        own, to_bearings = bearings_per_sensors(self.rig, self._omega)
        return own.reshape(len(self.harmonics), -1, self.rig.n_axes)[:, self.line].transpose(1, 0, 2), to_bearings

    @staticmethod
    def _static_real(X: Complex) -> Complex:
        X = X.copy()
        X[:, 0] = X[:, 0].real
        return X

    def _drawn(self, flux: Complex) -> tuple[Array, Array]:
        """Current that makes flux over a period, and what of it is magnetically effective, (P, T, n) each."""
        m = self.rig.magnets
        banded = np.any(m.hysteresis_rad > 0) and (m.hysteresis_narrowest_a or m.hysteresis_widest_inverse_per_a)
        n_time = 64 if banded else 32 if self._strongly else 16
        i_t = period_samples(flux, self.harmonics, n_time) + self._point.current_a
        return i_t, magnetic_force.effective(m, i_t)

    def _beyond_linear(self, drawn: tuple[Array, Array], x: Complex) -> Complex:
        """Bearing force beyond the linear one, on the rotor, (P, H, n), of what `_drawn` gives at a displacement."""
        i_t, effective = drawn
        passed = None if self.progress is None else self.progress[:, None, None]
        x_t = period_samples(x, self.harmonics, i_t.shape[1])
        excess = magnetic_force.beyond_linear(self.rig, self._point, i_t, effective, x_t, passed)
        return amplitudes(excess, self.harmonics)

    def _current(self, U: Complex, seen: Complex | None = None) -> tuple[Complex, Complex]:
        """Sampled coil current, and the control signal that a linear amplifier would need for it."""
        m = self._model
        linear = self._static_real(self._at_points(m.i_per_u, U))
        if not self._slews:
            return linear, U
        amp, line = self.rig.amplifiers, self._lines
        omega = self._omega[line]
        if amp.damping_ratio is None:
            sampled, change = slew_limit.first_order(self.rig, omega, self.harmonics, U)
        else:
            asked = 1j * omega[..., None] * self._at_points(m.baseband, U)
            wanted = None if seen is None else seen - linear
            sampled = change = slew_limit.second_order(amp, omega, self.harmonics, asked, wanted)
        with np.errstate(divide="ignore", invalid="ignore"):
            drive = amplifier.continuous(amp, self._omega)[line]
        hold = amplifier.hold(self._omega, self.rig.controller.sample_time_s)[line]
        delay = np.exp(-1j * omega[..., None] * (amp.delay_s + self.rig.controller.computing_delay_s))
        equivalent = U + np.linalg.solve(amp.crosstalk, (change / (drive * hold[..., None] * delay))[..., None])[..., 0]
        return linear + sampled, equivalent

    @property
    def _lines(self) -> Index:
        """Place of each point's harmonics among all lines, (P, H)."""
        H = len(self.harmonics)
        return np.asarray(self.line[:, None] + np.arange(H) * (len(self._omega) // H))


def respond_to_excitation(responder: Responder, R: Complex, rounds: int = 6) -> tuple[Complex, Answer]:
    """Closed loop: logged control signal and answer to excitation amplitudes R (P, H, n), u = r - C y.

    Newton-like: the linear loop maps what the nonlinear answer lacks back on u.
    """
    m, H, known = responder._model, len(responder.harmonics), responder._known
    controller = m.controller.reshape(H, -1)[:, responder.line].T[:, known, None]  # (P, H, 1)
    sensitivity, late = responder._of_points(m.sensitivity)[:, known], responder._log_phase[:, known]
    U = _times(sensitivity, R)
    for _ in range(rounds):
        lacking = R - controller * responder.displacement(U / late) - U
        U = U + _times(sensitivity, lacking)
        if 0 in responder.harmonics and (mean := responder.harmonics.index(0)) in known:
            U[:, known.index(mean)] = U[:, known.index(mean)].real  # a static signal has no phase
    logged = U / late
    return logged, responder.answer(logged)


def bearings_per_sensors(rig: Rig, omega_rad_s: Array) -> tuple[Complex, Array]:
    """Displacement per signal of each sensor, (F, n), and displacements at sensors -> at bearings of a rigid rotor."""
    rotor = rig.rotor
    (a, b), (sa, sb) = rotor.bearing_from_cog_m, rotor.sensor_from_cog_m
    plane = np.array([[1.0, a], [1.0, -b]]) @ np.linalg.inv([[1.0, sa], [1.0, -sb]])
    return 1 / sensor.response(rig.sensors, omega_rad_s), np.kron(np.eye(rig.n_axes // 2), plane).T


def time_points(frequency_hz: Array) -> tuple[Array, Index]:
    """Distinct frequencies and the index of each point's among them.

    >>> time_points(np.array([10.0, 20.0, 10.0]))
    (array([10., 20.]), array([0, 1, 0]))
    """
    distinct, line = np.unique(np.asarray(frequency_hz, dtype=float), return_inverse=True)
    return distinct, line.astype(np.int64)


__all__ = ["Answer", "Responder", "bearings_per_sensors", "respond_to_excitation", "time_points"]
