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
    """Force of the differential pair of axis ``a``; rows of ``law`` are named in `sim.magnetic_force.law_rows`."""
    p, q = law[2, a] - x - law[3, a], law[2, a] + x + law[3, a]
    upper, lower = max(law[1, a] + i, 0.0) * q, max(law[1, a] - i, 0.0) * p
    return law[0, a] * (upper - lower) * (upper + lower) / (p * p * q * q)


@_compiled
def _saturating_magnet(law, a, i, x):  # type: ignore[no-untyped-def]
    """The same of poles that saturate by their flux; beyond a pole, where no rotor is, by its size alone."""
    share, n = law[11, a], law[12, a]
    upper = max(law[1, a] + i, 0.0) / (law[2, a] - x - law[3, a])
    lower = max(law[1, a] - i, 0.0) / (law[2, a] + x + law[3, a])
    per_flux = share * law[2, a] / law[1, a]
    top = upper**2 / (1.0 + (per_flux * abs(upper)) ** n)
    bottom = lower**2 / (1.0 + (per_flux * abs(lower)) ** n)
    return law[0, a] * (1.0 + share**n) * (top - bottom)


@_compiled
def _quartic_magnet(law, a, i, x):  # type: ignore[no-untyped-def]
    """The same where n is 4, as in all but a few rigs: a power of any number takes longer than all the rest."""
    share = law[11, a]
    upper = max(law[1, a] + i, 0.0) / (law[2, a] - x - law[3, a])
    lower = max(law[1, a] - i, 0.0) / (law[2, a] + x + law[3, a])
    per_flux = share * law[2, a] / law[1, a]
    of_upper, of_lower = (per_flux * upper) ** 2, (per_flux * lower) ** 2
    top, bottom = upper**2 / (1.0 + of_upper * of_upper), lower**2 / (1.0 + of_lower * of_lower)
    return law[0, a] * (1.0 + share**4) * (top - bottom)


@_compiled
def excess_force(law, drifted, i_t, effective_t, x_t):  # type: ignore[no-untyped-def]
    """Force of each magnet beyond ki i + ks x, N, before it turns, of samples in time (n, P, T).

    ``i_t`` is the current that makes flux and ``effective_t`` what of it is effective, A, ``x_t`` the displacement, m;
    ``drifted`` are factors of the force and, of position stiffness beside that, summands over ks, (2, n, P).
    """
    out = np.empty_like(x_t)
    for a in range(x_t.shape[0]):
        saturates, ki, ks, rest = law[11, a] != 0.0, law[4, a], law[5, a], law[10, a]
        for p in range(x_t.shape[1]):
            # a loop of its own for each law: so the compiler makes several samples at once
            if saturates and law[12, a] == 4.0:
                for t in range(x_t.shape[2]):
                    out[a, p, t] = _quartic_magnet(law, a, effective_t[a, p, t], x_t[a, p, t])
            elif saturates:
                for t in range(x_t.shape[2]):
                    out[a, p, t] = _saturating_magnet(law, a, effective_t[a, p, t], x_t[a, p, t])
            else:
                for t in range(x_t.shape[2]):
                    out[a, p, t] = _magnet(law, a, effective_t[a, p, t], x_t[a, p, t])
            factor, more = drifted[0, a, p], drifted[1, a, p] * ks - ks
            for t in range(x_t.shape[2]):
                out[a, p, t] = factor * out[a, p, t] + more * x_t[a, p, t] - ki * (i_t[a, p, t] - rest)
    return out


@_compiled
def _towards(gone, rate, most, time):  # type: ignore[no-untyped-def]
    """How far a first-order amplifier has gone after a time, in time constants; ``rate`` where nothing was gone yet.

    The rate asked for falls as the current comes nearer; in between it may come to lie below the limit.
    """
    left = rate - gone
    at_limit = min(max(abs(left) / most - 1.0, 0.0), time)
    gone += math.copysign(most * at_limit, left)
    return rate + (gone - rate) * math.exp(at_limit - time)


@_compiled
def _slewed(before, after, share, lag, most, fall):  # type: ignore[no-untyped-def]
    """Rate to add in a step to a first-order amplifier without limit, for it to get as far as one with it.

    ``before`` and ``after`` are the rates that are asked of its current at the beginning of the step, until its signal
    steps after a ``share`` of it and from then on; ``fall`` is the step in time constants. A ``lag``, in steps, that is
    part of that share lets the signal rise only gradually: it is at the limit later by what the rest of its rise takes.
    """
    if lag > 0.0 and share > 0.0 and share < 1.0 and abs(after) > most:
        room = (math.copysign(most, after) - before) / (after - before)
        if room > 0.0 and room < 1.0:
            share = min(share - lag * math.log(1.0 - room), 1.0)
    first = share * fall
    free = -before * math.expm1(-first)
    if (share == 0.0 or abs(before) <= most) and abs(after - free) <= most:
        return 0.0
    limited = _towards(_towards(0.0, before, most, first), after, most, fall - first)
    free = after + (free - after) * math.exp(first - fall)
    return (limited - free) / -math.expm1(-fall)


@_compiled
def plain_corrections(now, at, law, d):  # type: ignore[no-untyped-def]
    """Force beyond the linear one of magnets without saturation, play, contact, slew limit or rotation."""
    n = law.shape[1]
    for a in range(n):
        flux, x = now[at + a], now[at + n + a]
        i = min(max(flux, -law[8, a]), law[8, a])
        d[a] = _magnet(law, a, i, x) + law[6, a] - law[4, a] * flux - law[5, a] * x


@_compiled
def _stop(contact, a, now, at):  # type: ignore[no-untyped-def]
    """Force of the stops of an axis, as `sim.actuator.stop_force` has it; ``at`` is where displacements begin."""
    n = contact.shape[1]
    away, ring = now[at + a] - contact[3, a], contact[4, a]
    stiffness, depth = contact[1 if away > 0.0 else 2, a], abs(away) - contact[0, a]
    force = -stiffness * math.copysign(depth, away) if depth > 0.0 else 0.0
    if ring > 0.0:
        b = (a + n // 2) % n  # the other plane at the same bearing
        rho = math.hypot(away / contact[0, a], (now[at + b] - contact[3, b]) / contact[0, b])
        radial = -stiffness * (1.0 - 1.0 / rho) * away if rho > 1.0 else 0.0
        force += ring * (radial - force)
    return force


@_compiled
def corrections(  # type: ignore[no-untyped-def]
    now, at, law, rotation, contact, slews, slew, driven, lag, fall, plays, play_w, play_t, scale, f, d
):
    """Force and slew beyond the linear ones, with every nonlinear effect; moves the plays along.

    ``driven`` is of `_driven` what the control signal asks of each amplifier beside what ``now`` tells of its state, by
    a lag of so many steps; ``fall`` how many time constants of such an amplifier a step takes, 0 for one that u does
    not drive at once.
    """
    n = law.shape[1]
    for a in range(n):
        x = now[at + n + a]
        i = min(max(now[at + a], -law[8, a]), law[8, a])
        if law[9, a] > 0.0:
            total = i
            moved = i - law[10, a] + law[13, a] * x  # loops lie about the operating point
            for j in range(play_t.shape[0]):
                plays[a, j] = min(max(plays[a, j], moved - play_t[j]), moved + play_t[j])
                total += 2.0 * law[9, a] * play_w[j] * plays[a, j]
            i = total
        if law[7, a] < NONE:
            i = law[7, a] * math.tanh(i / law[7, a])
        if law[11, a] == 0.0:
            force = _magnet(law, a, i, x)
        elif law[12, a] == 4.0:
            force = _quartic_magnet(law, a, i, x)
        else:
            force = _saturating_magnet(law, a, i, x)
        f[a] = scale[0, a] * force + (scale[1, a] - scale[0, a]) * law[5, a] * x
        if slews:
            rate = now[at + 2 * n + a]
            if fall[a] > 0.0:
                d[n + a] = _slewed(rate + driven[0, a], rate + driven[1, a], driven[2, a], lag[a], slew[a], fall[a])
            else:
                d[n + a] = min(max(rate, -slew[a]), slew[a]) - rate
    for a in range(n):
        total = law[6, a]
        for b in range(n):
            total += rotation[a, b] * (f[b] - law[4, b] * now[at + b] - law[5, b] * now[at + n + b])
        d[a] = total + _stop(contact, a, now, at + n)


@_compiled
def _driven(rate_input, late, state, first_u, s, out):  # type: ignore[no-untyped-def]
    """Rates that the control signals ask for in step s of a sample, before and after their axis's own one steps.

    The third row is the share of the step until then; of another axis's signal its mean over the step counts.
    """
    n = out.shape[1]
    for a in range(n):
        out[0, a], out[1, a], out[2, a] = 0.0, 0.0, min(max(late[1, a] - s, 0.0), 1.0)
    for b in range(n):
        at = first_u + int(late[0, b]) * n + b
        old = out[2, b]
        new, last = state[at], state[at + n] if old > 0.0 else state[at]
        mean = old * last + (1.0 - old) * new
        for a in range(n):
            out[0, a] += rate_input[a, b] * (last if a == b else mean)
            out[1, a] += rate_input[a, b] * (new if a == b else mean)


@_compiled
def _control(b, a, state, axis, error):  # type: ignore[no-untyped-def]
    """One sample of the controller of one axis, direct form II transposed."""
    out = b[axis, 0] * error + state[axis, 0]
    last = state.shape[1] - 1
    for k in range(last):
        state[axis, k] = b[axis, k + 1] * error - a[axis, k + 1] * out + state[axis, k + 1]
    state[axis, last] = b[axis, last + 1] * error - a[axis, last + 1] * out
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
    driven, drives = np.zeros((3, n)), slews and np.any(fall > 0.0)
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
                    now,
                    at,
                    law,
                    rotation,
                    contact,
                    slews,
                    slew,
                    driven,
                    late[2],
                    fall,
                    plays,
                    play_w,
                    play_t,
                    scale,
                    f,
                    d,
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
