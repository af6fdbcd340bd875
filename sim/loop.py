"""The time loop of a rig: nonlinear, sampled, all axes at once; `sim.kernel` is what is compiled of it.

Between two instants of the integration the linear part of the rig is advanced exactly, by its matrix exponential
(`sim.propagators`); what is nonlinear (the magnets' law beyond its linearisation, saturation, hysteresis, contact,
the supply's voltage limit) enters as a correction that is integrated by the second-order exponential rule ETD2 (Cox
and Matthews, J. Comput. Phys. 176, 2002, eq. 6). So the integration error is only that of the small nonlinear part,
and the control signal may change anywhere inside a step (delays).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim import actuator, control_law, magnetic_force
from sim.actuator import force_rotation
from sim.errors import LevitationError
from sim.kernel import NONE, advance, corrections, plain_corrections
from sim.propagators import asked_rate, propagators
from sim.rig import Array, Rig
from sim.state_space import state_space


class Loop:
    """The sampled loop of a rig without noise, disturbances and log.

    Parameters
    ----------
    rig : Rig
    substeps : int
        Integration steps a controller sample.

    Raises
    ------
    LevitationError
        The closed loop is unstable; the message tells the fastest growing pole.
    """

    def __init__(self, rig: Rig, substeps: int) -> None:
        self.rig, self.n_axes, self.substeps = rig, rig.n_axes, substeps
        self._point = actuator.operating_point(rig)
        self._ss = state_space(rig, self._point)
        self._b, self._a = control_law.transposed_forms(rig.controller, rig.n_axes)
        _, self._play_weights, self._play_widths = actuator.plays(rig.magnets)
        self._law = magnetic_force.law_rows(rig.magnets, self._point)
        self._rotation = force_rotation(rig)
        m, c, d = rig.magnets, rig.contact, rig.drift
        self._contact = actuator.stop_rows(c, rig.n_axes, rig.n_planes)
        self._slew = np.minimum(rig.amplifiers.slew_limit_a_per_s, NONE)
        self._slews = bool(np.any(self._slew < NONE))
        self._general = bool(
            np.any(self._law[7] < NONE)
            or np.any(self._law[9] > 0)
            or np.any(m.flux_share)
            or self._slews
            or c
            or d
            or np.any(self._rotation != np.eye(rig.n_axes))
        )
        self._asked = asked_rate(rig, self._ss, substeps)
        self._seen = self._seen_rows()
        self._p = propagators(rig, self._ss, self._seen, self._asked, substeps, self._slews)
        self._drift, self._drift_time = np.zeros((2, rig.n_axes)), np.zeros(2)
        if d:
            self._drift = np.stack([d.ki_change, d.ks_change])
            self._drift_time = np.array([d.duration_s / self._period_s, d.curvature])
        self.require_stability()
        self.levitate()

    @property
    def _period_s(self) -> float:
        return self.rig.controller.sample_time_s

    def _seen_rows(self) -> Array:
        """Rows of what each step shows of the state: flux, displacement at the bearings, rate, sensor output."""
        ss = self._ss
        rate = [self._asked.per_state] if self._slews else []
        sensor = [ss.sensor] if np.any(self._lag_steps > 0) else []
        return np.vstack([ss.flux, ss.bearing, *rate, *sensor])

    def levitate(self) -> None:
        """Put the rotor at rest at its operating point, time zero."""
        ss, n, p = self._ss, self.n_axes, self._p
        gain = self.rig.amplifiers.gain[:, None] * self.rig.amplifiers.crosstalk
        u = np.asarray(np.linalg.solve(gain, self._point.current_a), dtype=float)
        # Amplifiers and eddy currents at rest under that u; the rotor does not move.
        moving = np.flatnonzero(
            np.any(ss.drive != 0, axis=1)
            | np.any(ss.current != 0, axis=0)
            | np.any(ss.flux != 0, axis=0)
            | np.any(ss.current_rate != 0, axis=0)
        )
        z = np.zeros(p.n_z)
        z[moving] = np.linalg.solve(ss.A[np.ix_(moving, moving)], -(ss.drive @ u)[moving])
        self._state = np.zeros(p.first.shape[1])
        self._state[: p.n_z] = z
        self._state[p.n_z : p.n_z + p.history * n] = np.tile(u, p.history)
        self._now = np.zeros(p.first.shape[2])
        self._now[p.z_at - p.n_seen : p.z_at] = self._seen @ z
        self._c = np.stack([self._resting_controller(a, value) for a, value in zip(self._a, u, strict=True)])
        depth = int(np.ceil(np.max(self._lag_steps))) + 4
        self._y_past = np.zeros((n, depth))
        self._plays = np.zeros((n, len(self._play_widths)))
        self._rest_corrections(u)

    def _rest_corrections(self, u: Array) -> None:
        """Corrections at rest as those of a step before: the first step sees no slope in them."""
        p, d = self._p, np.zeros(self._p.later.shape[1])
        at, first = p.z_at - p.n_seen, p.n_z + p.history * self.n_axes
        if self._general:
            corrections(
                self._now,
                at,
                self._law,
                self._rotation,
                self._contact,
                self._slews,
                self._slew,
                np.stack([self._asked.per_input @ u, self._asked.per_input @ u, np.zeros(self.n_axes)]),
                p.late[2],
                p.fall,
                self._plays,
                self._play_weights,
                self._play_widths,
                np.ones((2, self.n_axes)),
                np.zeros(self.n_axes),
                d,
            )
        else:
            plain_corrections(self._now, at, self._law, d)
        self._state[first : first + p.n_d] = d[: p.n_d]

    @property
    def _lag_steps(self) -> Array:
        return np.asarray(self.rig.sensors.delay_s * self.substeps / self._period_s)

    @staticmethod
    def _resting_controller(a: Array, u: float) -> Array:
        """State of a controller of denominator ``a`` that puts out ``u`` at zero input; zero if no pole is at z = 1."""
        order = len(a) - 1
        if u == 0 or abs(np.sum(a)) > 1e-9:
            return np.zeros(order)
        return np.array([-u * np.sum(a[k + 1 :]) for k in range(order)])

    def closed_loop(self) -> Array:
        """One sample of the linear closed loop as a matrix on [z, controller states, past u].

        Dead time of a sensor counts as that of its axis's amplifier: about the loop both are the same, as each axis has
        a controller of its own (with crosstalk between axes whose sensors differ, nearly so).
        """
        if np.any(self.rig.sensors.delay_s):
            rig, delay = self.rig, self.rig.sensors.delay_s
            elsewhere = replace(
                rig,
                sensors=replace(rig.sensors, delay_s=np.zeros(rig.n_axes)),
                amplifiers=replace(rig.amplifiers, delay_s=rig.amplifiers.delay_s + delay),
            )
            return Loop(elsewhere, self.substeps).closed_loop()
        ss, p, n = self._ss, self._p, self.n_axes
        order, n_z = self._a.shape[1] - 1, p.n_z
        n_c, n_u = n * order, p.history * n
        eye = np.eye(n_z + n_c + n_u)
        z, c, past = eye[:n_z], eye[n_z : n_z + n_c].reshape(n, order, -1), eye[n_z + n_c :]
        y = ss.sensor @ z
        u = c[:, 0] - self._b[:, :1] * y
        shifted = np.concatenate([c[:, 1:], np.zeros_like(c[:, :1])], axis=1)
        c = shifted - self._b[:, 1:, None] * y[:, None] - self._a[:, 1:, None] * u[:, None]
        past = np.vstack([u, past[:-n]])
        z = p.first[0, : n_z + n_u, p.z_at : p.z_at + n_z].T @ np.vstack([z, past])
        return np.vstack([z, c.reshape(n_c, -1), past])

    def require_stability(self) -> None:
        """Refuse a closed loop with a growing pole."""
        poles = np.linalg.eigvals(self.closed_loop())
        worst = poles[np.argmax(np.abs(poles))]
        if np.abs(worst) >= 1.0 + 1e-9:
            frequency = np.abs(np.angle(worst)) / (2 * np.pi * self._period_s)
            raise LevitationError(
                f"rig {self.rig.name}: its controller does not levitate the rotor, a closed-loop pole at "
                f"{frequency:.0f} Hz grows by {100 * (np.abs(worst) - 1):.2g} % a sample; "
                "change the controller's coefficients"
            )

    def run(self, r: Array, added_i: Array, added_y: Array, started: int, check_limits: bool) -> tuple[int, int, Array]:
        """Samples done, the limit that was exceeded (0 none, 1 displacement, 2 current), and u, i, y (3, N, n).

        ``added_i`` and ``added_y`` are what is measured beside the true signals; ``started`` counts the samples
        since the rotor was levitated, for magnets that drift.
        """
        p, noise = self._p, self.rig.noise
        logged = np.empty((3, *r.shape))
        done, exceeded = advance(
            np.ascontiguousarray(r),
            np.ascontiguousarray(added_i),
            np.ascontiguousarray(added_y),
            self._state,
            self._now,
            self._c,
            self._y_past,
            self._plays,
            self._b,
            self._a,
            p.first,
            p.later,
            p.n_z,
            p.history,
            p.n_seen,
            p.n_d,
            self._ss.current,
            self._ss.sensor,
            self._rotation,
            self._law,
            self._contact,
            self._slew,
            self._asked.per_input,
            p.late,
            p.fall,
            self._play_weights,
            self._play_widths,
            self._lag_steps,
            np.array([noise.displacement_step_m, noise.current_step_a]),
            np.array([self.rig.displacement_limit_m, self.rig.current_limit_a]),
            check_limits,
            self._general,
            self._slews,
            self._drift,
            self._drift_time,
            started,
            logged,
        )
        return done, exceeded, logged
