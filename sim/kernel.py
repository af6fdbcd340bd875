"""What is compiled of the time loop: control, measurement, and the integration between two instants; see `sim.loop`.

Everything is an argument: numba compiles it once for all rigs, and keeps it on disk. `NONE` stands for an absent limit.
"""

from __future__ import annotations

import math

import numba
import numpy as np

NONE = 1e30
"""Stands for an absent limit: the fast arithmetic has no infinities."""

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
    """Force of the differential pair of axis ``a``; rows of ``law`` are named in `sim.loop.Loop._law_rows`."""
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
def _slewed(rate, most, fall):  # type: ignore[no-untyped-def]
    """Rate from which a first-order amplifier without limit gets as far in a step as one with it from ``rate``.

    The rate asked for falls as the current comes nearer; within the step it may come to lie below the limit.
    """
    if abs(rate) <= most:
        return rate
    at_limit = min(abs(rate) / most - 1.0, fall)
    return math.copysign(most * (at_limit - math.expm1(at_limit - fall)) / -math.expm1(-fall), rate)


@_compiled
def plain_corrections(now, at, law, d):  # type: ignore[no-untyped-def]
    """Force beyond the linear one of magnets without saturation, play, contact, slew limit or rotation."""
    n = law.shape[1]
    for a in range(n):
        flux, x = now[at + a], now[at + n + a]
        i = min(max(flux, -law[8, a]), law[8, a])
        d[a] = _magnet(law, a, i, x) + law[6, a] - law[4, a] * flux - law[5, a] * x


@_compiled
def corrections(  # type: ignore[no-untyped-def]
    now, at, law, rotation, contact, slews, slew, driven, fall, plays, play_w, play_t, scale, f, d
):
    """Force and slew beyond the linear ones, with every nonlinear effect; moves the plays along.

    ``driven`` is the rate that the control signal asks of each amplifier beside what ``now`` tells of its state;
    ``fall`` how many time constants of such an amplifier a step takes, 0 for one that u does not drive at once.
    """
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
        if law[7, a] < NONE:
            i = law[7, a] * math.tanh(i / law[7, a])
        force = _saturating_magnet(law, a, i, x) if law[11, a] > 0.0 else _magnet(law, a, i, x)
        f[a] = scale[0, a] * force + (scale[1, a] - scale[0, a]) * law[5, a] * x
        if slews:
            rate = now[at + 2 * n + a] + driven[a]
            d[n + a] = (_slewed(rate, slew[a], fall[a]) if fall[a] > 0.0 else min(max(rate, -slew[a]), slew[a])) - rate
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
def _driven(rate_input, late, state, first_u, s, out):  # type: ignore[no-untyped-def]
    """Rate that the control signal asks for in step s of a sample: that of its mean, as it may change within."""
    n = out.shape[0]
    for a in range(n):
        out[a] = 0.0
    for b in range(n):
        at = first_u + int(late[0, b]) * n + b
        old = min(max(late[1, b] - s, 0.0), 1.0)
        u = (1.0 - old) * state[at] + (old * state[at + n] if old > 0.0 else 0.0)
        for a in range(n):
            out[a] += rate_input[a, b] * u


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
def advance(  # type: ignore[no-untyped-def]
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
    rate_input,
    late,
    fall,
    play_w,
    play_t,
    lag,
    steps,
    limits,
    check,
    general,
    slews,
    drift,
    drift_time,
    started,
    logged,
):
    """Run the loop for the rows of r; returns (samples done, which limit was exceeded)."""
    n_samples, n = r.shape
    substeps = later.shape[0] + 1
    first_u, first_d = n_z, n_z + history * n
    last_seen, z_at = n_seen * (substeps - 1), n_seen * substeps
    scale, f, d = np.ones((2, n)), np.zeros(n), np.zeros(later.shape[1])
    driven, drives = np.zeros(n), slews and np.any(fall > 0.0)
    delayed = np.max(lag) > 0.0
    for t in range(n_samples):
        if drift_time[0] > 0.0:
            elapsed = (started + t) / drift_time[0]
            if drift_time[1] > 1e-6:
                elapsed = math.expm1(-drift_time[1] * elapsed) / math.expm1(-drift_time[1])
            for axis in range(n):
                scale[0, axis], scale[1, axis] = 1.0 + drift[0, axis] * elapsed, 1.0 + drift[1, axis] * elapsed
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
            asked = abs(i)  # of the coil, which gives no more than its limit
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
            elif not max(abs(i), asked) <= limits[1] and exceeded == 0:
                exceeded = 2
        for s in range(substeps):
            at = n_seen * (s - 1) if s > 0 else last_seen
            if drives:
                _driven(rate_input, late, state, first_u, s, driven)
            if general:
                corrections(
                    now, at, law, rotation, contact, slews, slew, driven, fall, plays, play_w, play_t, scale, f, d
                )
            else:
                plain_corrections(now, at, law, d)
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
