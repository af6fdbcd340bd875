"""Harmonic balance: steady-state response of a rig to a known periodic control signal, harmonics 0 to 3.

The linear part is exact per harmonic (`sim.twin.linear_model`); the nonlinear part (the magnets' law, saturation,
hysteresis, contact, the supply's voltage limit) is evaluated in time over one period and fed back as forces, the
alternating frequency/time method (Cameron and Griffin, J. Appl. Mech. 56, 1989). The rig is weakly nonlinear, so a few
iterations converge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import overload

import numpy as np

from sim import amplifier, magnetic_force, sensor, slew_limit
from sim.actuator import OperatingPoint
from sim.alternating import Complex, Index, amplitudes, period_samples
from sim.at_points import responses
from sim.rig import Array, Rig
from sim.twin import LinearModel, linear_model, small_signal

RESPONSE = (0, 1, 2, 3)
"""Harmonics of the force that are computed, logged or not: through the nonlinearity, the mean and the second harmonic
of an off-centre rotor change its fundamental, too."""
STATIC_HZ = 1e-2
"""Frequency at which the static response (harmonic 0) is evaluated: far below every pole of an AMB rig."""


@dataclass(frozen=True)
class Answer:
    """Coil current and sensor signal, complex amplitudes, each (P, H, n)."""

    I: Complex
    Y: Complex


class Responder:
    """Responses of a rig at given frequencies; the excitation may differ from call to call.

    Parameters
    ----------
    rig : Rig
    frequency_hz : (F,) distinct excited frequencies
    line : (P,) index of each point's frequency
    harmonics : those of the signals, ascending, 1 among them. The force also has the others of `RESPONSE`; there the
        response is that of the rig's own closed loop
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
        # A logging offset does not act in the rig: the logged control signal is corrected first.
        in_loop = replace(rig, logging_offset_samples=0.0) if rig.logging_offset_samples else rig
        self._model: LinearModel = linear_model(small_signal(in_loop), grid)
        self._point: OperatingPoint = self._model.point
        late = np.exp(-1j * self._omega * rig.controller.sample_time_s * rig.logging_offset_samples)
        self._log_phase: Complex = late.reshape(len(self.harmonics), -1)[:, line].T[..., None]  # (P, H, 1)
        self._strongly_nonlinear = bool(
            np.any(rig.magnets.hysteresis_rad > 0)
            or rig.contact
            or np.any(np.isfinite(rig.magnets.saturation_current_a))
            or np.any(rig.magnets.flux_share)
        )
        self._slews = bool(np.any(np.isfinite(rig.amplifiers.slew_limit_a_per_s)))

    def _of_points(self, matrices: Complex) -> Complex:
        """Values of each harmonic's lines, (H F, ...) -> those of the points, (P, H, ...)."""
        return np.asarray(self._by_harmonic(matrices).swapaxes(0, 1)[self.line])

    def _by_harmonic(self, matrices: Complex) -> Complex:
        """(H F, ...) -> (H, F, ...)."""
        return matrices.reshape(len(self.harmonics), -1, *matrices.shape[1:])

    def _at_points(self, matrices: Complex, x: Complex) -> Complex:
        """Matrices of each harmonic's lines, (H F, a, b) or (H, F, a, b), times amplitudes (P, H, b) -> (P, H, a)."""
        return responses(self._by_harmonic(matrices) if matrices.ndim == 3 else matrices, self.line, x)

    def answer(
        self, U: Complex, rounds: int | None = None, seen: Complex | None = None, seen_current: Complex | None = None
    ) -> Answer:
        """Response to logged control amplitudes U, (P, H, n), harmonics as given to the constructor.

        Parameters
        ----------
        seen
            (P, H, n) measured sensor signal. The plant is unstable, so for a given U the iteration of a strongly
            nonlinear force may diverge; evaluated at the measured displacement, it does not.
        seen_current
            (P, H, n) measured coil current: as `current`.
        """
        current, effective = self._current(self._control_in_loop(U), self._padded(seen_current))
        return Answer(current[:, self._known], self._displacement(effective, rounds, self._padded(seen)))

    def displacement(
        self, U: Complex, rounds: int | None = None, seen: Complex | None = None, seen_current: Complex | None = None
    ) -> Complex:
        """Sensor signal of `answer` alone, (P, H, n), in half the time."""
        effective = self._control_in_loop(U)
        if self._slews:
            effective = self._current(effective, self._padded(seen_current))[1]
        return self._displacement(effective, rounds, self._padded(seen))

    def beyond_linear(self, U: Complex, seen: Complex | None = None, seen_current: Complex | None = None) -> Complex:
        """`displacement` less what small signals make of the fundamental, (P, H, n)."""
        out, f = self.displacement(U, None, seen, seen_current), self.harmonics.index(1)
        of_fundamental = self._by_harmonic(self._model.y_per_u)[f]
        out[:, self._known.index(f)] -= responses(of_fundamental, self.line, self._control_in_loop(U)[:, f])
        return out

    def current(self, U: Complex, seen: Complex | None = None) -> Complex:
        """Sampled coil current for logged control amplitudes U, (P, H, n): the amplifiers alone.

        An amplifier beyond its slew limit may have two steady states: the one nearer to ``seen`` (P, H, n) is returned
        where that is given, else the one that a rising amplitude leads to.
        """
        return self._current(self._control_in_loop(U), self._padded(seen))[0][:, self._known]

    def _control_in_loop(self, U: Complex) -> Complex:
        """Control signal in the loop, all harmonics, from the logged one, (P, H, n): 0 where none was logged."""
        return self._padded(U) * self._log_phase

    @overload
    def _padded(self, X: Complex) -> Complex: ...

    @overload
    def _padded(self, X: Complex | None) -> Complex | None: ...

    def _padded(self, X: Complex | None) -> Complex | None:
        """A signal with 0 in the harmonics that were not logged."""
        if X is None or not self._unknown:
            return X
        whole = np.zeros((X.shape[0], len(self.harmonics), X.shape[2]), dtype=complex)
        whole[:, self._known] = X
        return whole

    def _per_force(self) -> tuple[Complex, Complex, Complex | None]:
        """Displacements at bearings and at sensors per force, and the control signal where forces change it.

        Of each harmonic's lines, (H, F, n, n) each. At logged harmonics the control signal is given, and the loop is
        open; it is closed at those that were not logged. None where all were.
        """
        m, k, by_harmonic = self._model, self._unknown, self._by_harmonic
        x, y = by_harmonic(m.bearing_per_force), by_harmonic(m.y_per_force)
        if not k:
            return x, y, None
        below = self._omega.reshape(len(self.harmonics), -1)[k] * self.rig.controller.sample_time_s < np.pi
        C = np.where(below[..., None], by_harmonic(m.controllers)[k], 0.0)[..., None]
        x, y, u = x.copy(), y.copy(), np.zeros_like(y)
        y[k] = np.linalg.solve(np.eye(y.shape[-1]) + C * by_harmonic(m.y_per_u)[k], y[k])
        u[k] = -C * y[k]
        x[k] += by_harmonic(m.bearing_per_u)[k] @ u[k]
        return x, y, u

    def _displacement(self, U: Complex, rounds: int | None, seen: Complex | None) -> Complex:
        """Sensor signal, (P, H, n), for the control signal U of linear amplifiers."""
        m = self._model
        x_linear, Y_linear = self._at_points(m.bearing_per_u, U), self._at_points(m.y_per_u, U)
        bearing, sensed, fed = self._per_force()
        if seen is not None:  # where the rotor was, x + (seen - Y) at the bearings; Y and x change with the force
            x_linear = x_linear + self._from_sensors(seen - Y_linear)
            bearing = bearing - self._rigid_bearing_per_sensor() @ sensed
        currents, means = self._effective_currents(self._at_points(m.flux_per_u, U)), self._means(seen)

        force = self._beyond_linear(currents, x_linear, means)
        for _ in range((rounds or self._rounds(seen is not None)) - 1):
            if fed is not None:
                currents = self._effective_currents(self._at_points(m.flux_per_u, U + self._at_points(fed, force)))
            force = self._beyond_linear(currents, x_linear + self._at_points(bearing, force), means)
        return self._static_real(Y_linear + self._at_points(sensed, force))[:, self._known]

    def _rounds(self, seen: bool) -> int:
        """Evaluations of the force until more would change nothing that can be measured.

        Where the rotor was seen, only its flexibility is left to follow the force: from one to the next the error falls
        by a factor of 20 and more, and after the second it was at most 1.2e-4 of the signal in rigs of an independent
        program, a thousandth of the noise, rms. Off centre, where the mean is left to follow, too, it was 2e-3 there,
        and up to 4e-4 after the third.
        """
        if not seen:
            return 6 if self._strongly_nonlinear else 3
        return 3 if np.any(self.rig.magnets.offset_m) else 2

    def _means(self, seen: Complex | None) -> Complex | None:
        """Mean displacement at the bearings, (P, n), from rest, where stops need it as it was measured; or None.

        A stop stiffer than the magnets that is on one side pushes the rotor off; from the mean of the control signal
        that holds against it, the model would find the rotor on its other side, where it does not touch. Rest is the
        median over the points, as a sensor's zero is not known.
        """
        if seen is None or self.rig.contact is None or 0 not in self._known:
            return None
        own, to_bearings = bearings_per_sensors(self.rig, self._omega[:1])
        mean = seen[:, 0].real
        return np.asarray(((mean - np.median(mean, axis=0)) * own) @ to_bearings)

    def _from_sensors(self, Y: Complex) -> Complex:
        """Displacement at the bearings, (P, H, n), of a rigid rotor with sensor signals Y.

        It only corrects the model's displacement by the difference to the measured one, so flexibility is neglected.
        The mean is left to the model, as a sensor's zero is not known, and so are harmonics that were not logged.
        """
        own, to_bearings = self._sensed
        at_sensor = Y * own[:, self.line].swapaxes(0, 1)
        # one product for all points is six times as fast as one of each
        return np.asarray((at_sensor.reshape(-1, len(to_bearings)) @ to_bearings).reshape(at_sensor.shape))

    def _rigid_bearing_per_sensor(self) -> Complex:
        """The same as matrices of each harmonic's lines, (H, F, n, n)."""
        own, to_bearings = self._sensed
        return np.asarray(to_bearings.T * own[:, :, None, :])

    @cached_property
    def _sensed(self) -> tuple[Complex, Array]:
        """Displacement per signal of each sensor, (H, F, n), 0 where `_from_sensors` corrects nothing; to bearings."""
        own, to_bearings = bearings_per_sensors(self.rig, self._omega)
        own = own.reshape(len(self.harmonics), -1, self.rig.n_axes)
        own[[0, *self._unknown]] = 0.0
        return own, to_bearings

    @staticmethod
    def _static_real(X: Complex) -> Complex:
        """The amplitudes with a real harmonic 0, which comes first."""
        X = X.copy()
        X[:, 0] = X[:, 0].real
        return X

    def _effective_currents(self, flux: Complex) -> tuple[Array, Array | None]:
        """Flux-making current over a period, and its magnetically effective part, (P, T, n) each.

        None where that also depends on the displacement.
        """
        m = self.rig.magnets
        uneven = m.hysteresis_narrowest_a or m.hysteresis_widest_inverse_per_a or any(m.hysteresis_density)
        banded = np.any(m.hysteresis_rad > 0) and uneven
        n_time = 64 if banded else 32 if self._strongly_nonlinear else 16
        i_t = period_samples(flux, self.harmonics, n_time) + self._point.current_a
        return i_t, None if m.hysteresis_displacement_share else magnetic_force.effective(m, i_t)

    def _beyond_linear(self, currents: tuple[Array, Array | None], x: Complex, means: Complex | None) -> Complex:
        """Bearing force on the rotor beyond the linear one, (P, H, n), of `_effective_currents` at displacements x.

        The stops meet the measured ``means`` of the displacement, where they are given, and nothing else does: the
        magnets of a rig with stops answer to the noise of a mean as those of one without, or stops that touch nowhere
        would make a better twin.
        """
        i_t, effective = currents
        passed = None if self.progress is None else self.progress[:, None, None]
        x_t = period_samples(x, self.harmonics, i_t.shape[1])
        if effective is None:
            m = self.rig.magnets
            beside = magnetic_force.played_per_displacement(m, self._point) * x_t
            effective = magnetic_force.effective(m, i_t, beside_t=beside)
        at_stops = None if means is None else x_t + (means - x[:, 0]).real[:, None]
        excess = magnetic_force.beyond_linear(self.rig, self._point, i_t, effective, x_t, passed, at_stops)
        return amplitudes(excess, self.harmonics)

    def _current(self, U: Complex, seen: Complex | None = None) -> tuple[Complex, Complex]:
        """Sampled coil current, and the control signal from which linear amplifiers would make it."""
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
    """Closed loop: logged control signal and response to excitation amplitudes R (P, H, n), u = r - C y.

    A quasi-Newton iteration: the residual of u = r - C y is mapped to a correction of u by the linear loop.
    """
    m, known = responder._model, responder._known
    controller = responder._of_points(m.controllers)[:, known]  # (P, H, n)
    sensitivity, late = responder._by_harmonic(m.sensitivity)[known], responder._log_phase[:, known]
    U = responses(sensitivity, responder.line, R)
    for _ in range(rounds):
        residual = R - controller * responder.displacement(U / late) - U
        U = U + responses(sensitivity, responder.line, residual)
        if 0 in responder.harmonics and (mean := responder.harmonics.index(0)) in known:
            U[:, known.index(mean)] = U[:, known.index(mean)].real  # a static signal has no phase
    logged = U / late
    return logged, responder.answer(logged)


def bearings_per_sensors(rig: Rig, omega_rad_s: Array) -> tuple[Complex, Array]:
    """Displacement per signal of each sensor, (F, n), and the map from sensors to bearings of a rigid rotor, (n, n)."""
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
