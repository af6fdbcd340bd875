"""The compiled time loop of a rig: nonlinear, sampled, all axes at once.

Between two instants of the integration the linear part of the rig is advanced exactly, by its matrix exponential
(`sim.propagators`); what is nonlinear (the magnets' law beyond its linearisation, saturation, hysteresis, contact,
the supply's voltage limit) enters as a correction that is integrated by the second-order exponential rule ETD2 (Cox
and Matthews, J. Comput. Phys. 176, 2002, eq. 6). So the integration error is only that of the small nonlinear part,
and the control signal may change anywhere inside a step (delays).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sim import actuator, control_law
from sim.actuator import force_rotation
from sim.errors import LevitationError
from sim.propagators import propagators
from sim.rig import Array, Rig
from sim.state_space import state_space

_NONE = 1e30
"""Stands for an absent limit in the compiled loop, whose fast arithmetic has no infinities."""

_compiled = numba.njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")


@_compiled
def _add_product(weights, s, v, out):  # type: ignore[no-untyped-def]
    """Out += weights[s]^T v, four rows at a time; sizes are multiples of 4 and 8. No views: they cost more."""
    columns = weights.shape[2]
    for j in range(0, weights.shape[1], 4):
        v0, v1, v2, v3 = v[j], v[j + 1], v[j + 2], v[j + 3]
        for k in range(columns):
            out[k] += (
                weights[s, j, k] * v0
                + weights[s, j + 1, k] * v1
                + weights[s, j + 2, k] * v2
                + weights[s, j + 3, k] * v3
            )


@_compiled
def _magnet(law, a, i, x):  # type: ignore[no-untyped-def]
    """Force of the differential pair of axis ``a``; rows of ``law`` are named in `Loop._law_rows`."""
    p, q = law[2, a] - x - law[3, a], law[2, a] + x + law[3, a]
    upper, lower = max(law[1, a] + i, 0.0) * q, max(law[1, a] - i, 0.0) * p
    return law[0, a] * (upper - lower) * (upper + lower) / (p * p * q * q)


@_compiled
def _saturating_magnet(law, a, i, x):  # type: ignore[no-untyped-def]
    """The same of poles that saturate by their flux."""
    share, n = law[11, a], law[12, a]
    upper = max(law[1, a] + i, 0.0) / (law[2, a] - x - law[3, a])
    lower = max(law[1, a] - i, 0.0) / (law[2, a] + x + law[3, a])
    per_flux = share * law[2, a] / law[1, a]
    top = upper**2 / (1.0 + (per_flux * upper) ** n)
    bottom = lower**2 / (1.0 + (per_flux * lower) ** n)
    return law[0, a] * (1.0 + share**n) * (top - bottom)


@_compiled
def _plain_corrections(now, at, law, d):  # type: ignore[no-untyped-def]
    """Force beyond the linear one of magnets without saturation, play, contact, slew limit or rotation."""
    n = law.shape[1]
    for a in range(n):
        flux, x = now[at + a], now[at + n + a]
        i = min(max(flux, -law[8, a]), law[8, a])
        d[a] = _magnet(law, a, i, x) + law[6, a] - law[4, a] * flux - law[5, a] * x


@_compiled
def _corrections(now, at, law, rotation, contact, slews, slew, plays, play_w, play_t, scale, f, d):  # type: ignore[no-untyped-def]
    """Force and slew beyond the linear ones, with every nonlinear effect; moves the plays along."""
    n = law.shape[1]
    for a in range(n):
        x = now[at + n + a]
        i = min(max(now[at + a], -law[8, a]), law[8, a])
        if law[9, a] > 0.0:
            total = i
            moved = i - law[10, a]  # loops lie about the operating point
            for j in range(play_t.shape[0]):
                plays[a, j] = min(max(plays[a, j], moved - play_t[j]), moved + play_t[j])
                total += 2.0 * law[9, a] * play_w[j] * plays[a, j]
            i = total
        if law[7, a] < 1e30:
            i = law[7, a] * math.tanh(i / law[7, a])
        force = _saturating_magnet(law, a, i, x) if law[11, a] > 0.0 else _magnet(law, a, i, x)
        f[a] = scale[0] * force + (scale[1] - scale[0]) * law[5, a] * x
        if slews:
            rate = now[at + 2 * n + a]
            d[n + a] = min(max(rate, -slew[a]), slew[a]) - rate
    for a in range(n):
        total = law[6, a]
        for b in range(n):
            total += rotation[a, b] * (f[b] - law[4, b] * now[at + b] - law[5, b] * now[at + n + b])
        x = now[at + n + a]
        depth = abs(x) - contact[0, a]
        if depth > 0.0:
            total -= contact[1 if x > 0.0 else 2, a] * math.copysign(depth, x)
        d[a] = total


@_compiled
def _control(b, a, state, axis, error):  # type: ignore[no-untyped-def]
    """One sample of the controller of one axis, direct form II transposed."""
    out = b[0] * error + state[axis, 0]
    last = state.shape[1] - 1
    for k in range(last):
        state[axis, k] = b[k + 1] * error - a[k + 1] * out + state[axis, k + 1]
    state[axis, last] = b[last + 1] * error - a[last + 1] * out
    return out


@_compiled
def _delayed(past, lag_steps):  # type: ignore[no-untyped-def]
    """Cubic interpolation of a signal ``lag_steps`` integration steps ago; past[0] is the latest."""
    k = max(int(lag_steps) - 1, 0)
    w = lag_steps - k
    return (
        -past[k] * (w - 1) * (w - 2) * (w - 3) / 6
        + past[k + 1] * w * (w - 2) * (w - 3) / 2
        - past[k + 2] * w * (w - 1) * (w - 3) / 2
        + past[k + 3] * w * (w - 1) * (w - 2) / 6
    )


@_compiled
def _advance(  # type: ignore[no-untyped-def]
    r,
    added_i,
    added_y,
    state,
    now,
    c_state,
    y_past,
    plays,
    b,
    a,
    weights,
    later,
    n_z,
    history,
    n_seen,
    n_d,
    pick_i,
    pick_y,
    rotation,
    law,
    contact,
    slew,
    play_w,
    play_t,
    lag,
    steps,
    limits,
    check,
    general,
    slews,
    drift,
    started,
    logged,
):
    """Run the loop for the rows of r; returns (samples done, which limit was exceeded)."""
    n_samples, n = r.shape
    substeps = later.shape[0] + 1
    first_u, first_d = n_z, n_z + history * n
    last_seen, z_at = n_seen * (substeps - 1), n_seen * substeps
    scale, f, d = np.ones(2), np.zeros(n), np.zeros(later.shape[1])
    delayed = np.max(lag) > 0.0
    for t in range(n_samples):
        if drift[2] > 0.0:
            elapsed = (started + t) / drift[2]
            if drift[3] > 1e-6:
                elapsed = math.expm1(-drift[3] * elapsed) / math.expm1(-drift[3])
            scale[0], scale[1] = 1.0 + drift[0] * elapsed, 1.0 + drift[1] * elapsed
        for k in range(first_d - 1, first_u + n - 1, -1):
            state[k] = state[k - n]
        exceeded = 0
        for axis in range(n):
            y, i = 0.0, 0.0
            for k in range(n_z):
                y += pick_y[axis, k] * state[k]
                i += pick_i[axis, k] * state[k]
            if delayed:
                y_past[axis, 0] = y
                y = _delayed(y_past[axis], lag[axis])
            y += added_y[t, axis]
            i = min(max(i, -law[8, axis]), law[8, axis]) + added_i[t, axis]
            if steps[0] > 0.0:
                y = np.floor(y / steps[0] + 0.5) * steps[0]
            if steps[1] > 0.0:
                i = np.floor(i / steps[1] + 0.5) * steps[1]
            u = _control(b, a, c_state, axis, -y) + r[t, axis]
            state[first_u + axis] = u
            logged[0, t, axis], logged[1, t, axis], logged[2, t, axis] = u, i, y
            if not abs(y) <= limits[0]:
                exceeded = 1
            elif not abs(i) <= limits[1] and exceeded == 0:
                exceeded = 2
        for s in range(substeps):
            at = n_seen * (s - 1) if s > 0 else last_seen
            if general:
                _corrections(now, at, law, rotation, contact, slews, slew, plays, play_w, play_t, scale, f, d)
            else:
                _plain_corrections(now, at, law, d)
            if s == 0:
                for k in range(n_d):
                    state[first_d + n_d + k] = d[k]
                for k in range(now.shape[0]):
                    now[k] = 0.0
                _add_product(weights, 0, state, now)
            else:
                _add_product(later, s - 1, d, now)
            if delayed:
                for axis in range(n):
                    for j in range(y_past.shape[1] - 1, 0, -1):
                        y_past[axis, j] = y_past[axis, j - 1]
                    y_past[axis, 0] = now[n_seen * (s + 1) - n + axis]
        for k in range(n_z):
            state[k] = now[z_at + k]
        for k in range(n_d):
            state[first_d + k] = d[k]
        if exceeded > 0 and check:
            return t + 1, exceeded
    return n_samples, 0


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
        self._b, self._a = control_law.transposed_form(rig.controller)
        self._play_strength, self._play_weights, self._play_widths = actuator.plays(rig.magnets)
        self._law = self._law_rows()
        self._rotation = force_rotation(rig)
        m, c, d = rig.magnets, rig.contact, rig.drift
        self._contact = np.array([np.full(rig.n_axes, np.inf), np.zeros(rig.n_axes), np.zeros(rig.n_axes)])
        if c:
            self._contact = np.stack([c.clearance_m, *(np.full(rig.n_axes, k) for k in actuator.stop_stiffness(c))])
        self._slew = np.minimum(rig.amplifiers.slew_limit_a_per_s, _NONE)
        self._slews = bool(np.any(self._slew < _NONE))
        self._general = bool(
            np.any(self._law[7] < _NONE)
            or np.any(self._law[9] > 0)
            or m.flux_share
            or self._slews
            or c
            or d
            or m.cross_coupling_rad
            or m.cross_coupling_symmetric
        )
        self._seen = self._seen_rows()
        self._p = propagators(rig, self._ss, self._seen, substeps, self._slews)
        self._drift = np.zeros(4)
        if d:
            self._drift = np.array([d.ki_change, d.ks_change, d.duration_s / self._period_s, d.curvature])
        self.require_stability()
        self.levitate()

    @property
    def _period_s(self) -> float:
        return self.rig.controller.sample_time_s

    def _seen_rows(self) -> Array:
        """Rows of what each step shows of the state: flux, displacement at the bearings, rate, sensor output."""
        ss = self._ss
        rate = [ss.current_rate] if self._slews else []
        sensor = [ss.sensor] if np.any(self._lag_steps > 0) else []
        return np.vstack([ss.flux, ss.bearing, *rate, *sensor])

    def _law_rows(self) -> Array:
        """Rows k, i0, s0, offset, ki, ks, load, i_s, i_max, alpha, i at rest, B0/Bs, n of the force law, (13, n)."""
        m, p = self.rig.magnets, self._point
        return np.vstack(
            [
                m.ki * m.gap_m**2 / (4 * m.bias_current_a),
                m.bias_current_a,
                m.gap_m,
                m.offset_m,
                p.ki,
                p.ks,
                p.load_n,
                np.minimum(m.saturation_current_a, _NONE),
                np.full(self.n_axes, m.current_limit_a),
                self._play_strength,
                p.current_a,
                np.full(self.n_axes, m.flux_share),
                np.full(self.n_axes, m.flux_power),
            ]
        )

    def levitate(self) -> None:
        """Put the rotor at rest at its operating point, time zero."""
        ss, n, p = self._ss, self.n_axes, self._p
        u = np.linalg.solve(self.rig.amplifiers.gain[:, None] * self.rig.amplifiers.crosstalk, self._point.current_a)
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
        self._c = np.stack([self._resting_controller(value) for value in u])
        depth = int(np.ceil(np.max(self._lag_steps))) + 4
        self._y_past = np.zeros((n, depth))
        self._plays = np.zeros((n, len(self._play_widths)))
        self._rest_corrections()

    def _rest_corrections(self) -> None:
        """Corrections at rest as those of a step before: the first step sees no slope in them."""
        p, d = self._p, np.zeros(self._p.later.shape[1])
        at, first = p.z_at - p.n_seen, p.n_z + p.history * self.n_axes
        if self._general:
            _corrections(
                self._now,
                at,
                self._law,
                self._rotation,
                self._contact,
                self._slews,
                self._slew,
                self._plays,
                self._play_weights,
                self._play_widths,
                np.ones(2),
                np.zeros(self.n_axes),
                d,
            )
        else:
            _plain_corrections(self._now, at, self._law, d)
        self._state[first : first + p.n_d] = d[: p.n_d]

    @property
    def _lag_steps(self) -> Array:
        return np.asarray(self.rig.sensors.delay_s * self.substeps / self._period_s)

    def _resting_controller(self, u: float) -> Array:
        """Controller state that puts out ``u`` at zero input, from its pole at z = 1; zero without one."""
        order = len(self._a) - 1
        if u == 0 or abs(np.sum(self._a)) > 1e-9:
            return np.zeros(order)
        return np.array([-u * np.sum(self._a[k + 1 :]) for k in range(order)])

    def closed_loop(self) -> Array:
        """One sample of the linear closed loop as a matrix on [z, controller states, past u]."""
        ss, p, n = self._ss, self._p, self.n_axes
        order, n_z = len(self._a) - 1, p.n_z
        n_c, n_u = n * order, p.history * n
        eye = np.eye(n_z + n_c + n_u)
        z, c, past = eye[:n_z], eye[n_z : n_z + n_c].reshape(n, order, -1), eye[n_z + n_c :]
        y = ss.sensor @ z
        u = c[:, 0] - self._b[0] * y
        shifted = np.concatenate([c[:, 1:], np.zeros_like(c[:, :1])], axis=1)
        c = shifted - self._b[1:, None] * y[:, None] - self._a[1:, None] * u[:, None]
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
        done, exceeded = _advance(
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
            self._play_weights,
            self._play_widths,
            self._lag_steps,
            np.array([noise.displacement_step_m, noise.current_step_a]),
            np.array([self.rig.displacement_limit_m, self.rig.current_limit_a]),
            check_limits,
            self._general,
            self._slews,
            self._drift,
            started,
            logged,
        )
        return done, exceeded, logged
