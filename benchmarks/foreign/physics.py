"""Equations of motion of an AMB rig in generalised coordinates, and their integration by RK4.

Written from the physics, apart from the project's own simulation: it shares no line, no parameter structure
and no integrator with it, so that a diagnosis which holds here does not lean on its own twin.

Per plane up to seven coordinates: z (centre of gravity), theta, flexible modes of unit modal mass and housing
displacements. What a bearing or sensor sees is linear in them, ``x = T xi``, and magnets act by
virtual work, ``xi'' = M^-1 T' f - w^2 xi - 2 zeta w xi'``, on rotor and housing alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

NQ = 7
N_LADDER = 9
N_PLAYS = 6
I0, V0, P0, S0, Z0, C0, F0, L0 = 28, 32, 36, 40, 44, 48, 56, 60
N_STATES = L0 + 8 * N_LADDER
FAST = {"contract", "reassoc", "arcp", "nsz"}


# Everything between u and y, one record: numba passes it as a pointer. Axis a is end a % 2 (A, B) of plane a // 2.
PLANT = np.dtype(
    [
        ("nq", "i8"),  # coordinates in use
        ("tb", "f8", (2, 2, 7)),  # bearing displacement per coordinate
        ("ts", "f8", (2, 2, 7)),  # sensor displacement per coordinate
        ("minv", "f8", (2, 7)),
        ("w", "f8", (2, 7)),  # rad/s
        ("zeta", "f8", (2, 7)),
        ("cubic", "f8", (2, 7)),  # 1/m^2 of the coordinate: stiffness w^2 (1 + c q^2)
        ("square_damping", "f8", (2, 7)),  # damping zeta (1 + d q^2)
        ("bias", "f8", (4,)),  # A
        ("gap", "f8", (4,)),  # m
        ("k", "f8", (4,)),  # N m^2/A^2
        ("offset", "f8", (4,)),  # m
        ("saturation", "i8"),  # 0 none, 1 i_s tanh(i/i_s), 2 1/(1 + (B/Bs)^n) in each pole
        ("sat_level", "f8", (4,)),  # A, or B/B0 of the bias
        ("sat_power", "f8"),
        ("play_share", "f8", (4,)),
        ("play_width", "f8", (6,)),  # A
        ("ladder", "i8"),  # 0 none, 1 current, 2 current and displacement
        ("ladder_pole", "f8", (9,)),  # rad/s
        ("ladder_gain", "f8", (9,)),
        ("ladder_direct", "f8"),
        ("force_mix", "f8", (4, 4)),
        ("amp_w", "f8", (4,)),
        ("amp_zeta", "f8", (4,)),
        ("amp_gain", "f8", (4,)),
        ("amp_extra", "f8", (4,)),  # rad/s of a third pole, 0 none
        ("slew", "f8", (4,)),  # A/s at no current, inf none: U/L
        ("slew_resistive", "f8", (4,)),  # 1/s, R/L
        ("coil", "i8"),  # 0 limited slope of a filter, 1 coil under PI, 2 under P with feed-forward
        ("coil_gain", "f8", (4,)),  # 1/s, P of 2 over L
        ("u_mix", "f8", (4, 4)),
        ("dead_band", "f8", (4,)),  # A
        ("drive_limit", "f8", (4,)),  # A, inf none
        ("cable_share", "f8", (4,)),  # of the drive, through a resonant filter
        ("cable_w", "f8"),  # rad/s
        ("cable_zeta", "f8"),
        ("stop_gap", "f8", (4,)),  # m, inf none
        ("stop_stiffness", "f8"),
        ("stop_damping", "f8"),
        ("stop_both", "i8"),
        ("ring_cubic", "f8", (4,)),  # N/m^3
        ("ring_damping", "f8", (4,)),  # N s/m
        ("friction", "f8", (4,)),  # N
        ("friction_stiffness", "f8"),
        ("ks_swing", "f8"),
        ("ks_swing_hz", "f8"),
        ("hum_a", "f8", (4,)),  # A, on the drive
        ("hum_hz", "f8"),
        ("hum_phase", "f8"),
        ("sensor_w", "f8", (4,)),  # rad/s, 0 none
        ("spin", "f8"),  # rad/s, from x to y
        ("gyro", "f8", (7, 7)),  # kg m^2 per squared slope of the coordinates
        ("inner", "f8", (7,)),  # generalised damping that turns with the shaft
        ("seal", "f8", (3,)),  # N/m of cross-coupled stiffness at A, B and between them
        ("seal_by_speed", "f8", (3,)),  # N s/m, the same in proportion to the speed
        ("seal_at", "f8", (3, 7)),  # displacement there per coordinate
    ]
)


@njit(cache=True, fastmath=FAST, inline="always")
def _play(i, memory, share, width):
    """Current behind a stack of play operators of equal weight: a Rayleigh-like loop."""
    if share == 0.0:
        return i
    total = 0.0
    for j in range(N_PLAYS):
        total += max(i - width[j], min(i + width[j], memory[j]))
    return (1.0 - share) * i + share * total / N_PLAYS


@njit(cache=True, fastmath=FAST, inline="always")
def _pole(k, current, gap, law, level, power, b0):
    """Pull of one pole, N; saturation by its flux density relative to the bias."""
    f = k * current * current / (gap * gap)
    if law == 2:
        b = abs(current / gap) / b0
        f /= 1.0 + (b / level) ** power
    return f


@njit(cache=True, fastmath=FAST, inline="always")
def magnet_force(p, a, i, x, drift_k, drift_gap, swing):
    """Force of axis a, N, with the static pull of an off-centre rotor taken off (it is held by a set point)."""
    if p.saturation == 1:
        i = p.sat_level[a] * np.tanh(i / p.sat_level[a])
    s0 = p.gap[a] * drift_gap[a]
    k = p.k[a] * drift_k[a]
    b0 = p.bias[a] / p.gap[a]
    law, level, n = p.saturation, p.sat_level[a], p.sat_power
    e = x + p.offset[a]
    f = _pole(k, p.bias[a] + i, s0 - e, law, level, n, b0) - _pole(k, p.bias[a] - i, s0 + e, law, level, n, b0)
    if p.offset[a] != 0.0:
        o = p.offset[a]
        f -= _pole(k, p.bias[a], s0 - o, law, level, n, b0) - _pole(k, p.bias[a], s0 + o, law, level, n, b0)
    if swing != 0.0:
        f += swing * 4.0 * k * p.bias[a] ** 2 / s0**3 * x
    return f


@njit(cache=True, fastmath=FAST, inline="always")
def _coil(p, a, drive, s, ds):
    """Current of a coil under a current loop whose voltage is limited: L i' = v - R i, |v| <= U, all over L.

    Within the limit either loop is the datasheet's amplifier. PI: a lag in front cancels its zero; its integral is the
    limited voltage behind a lag (automatic reset), so it does not wind up. P: it holds the current at what a filter
    as on the datasheet makes of the drive, and adds the voltage that the coil needs for that.
    """
    i, f, w, r = s[I0 + a], s[F0 + a], p.amp_w[a], p.slew_resistive[a]
    damped = 2.0 * p.amp_zeta[a] * w
    if p.coil == 1:
        gain = damped - r
        v = gain * (f - i) + s[V0 + a]
    else:
        v = s[V0 + a] + r * f + p.coil_gain[a] * (f - i)
    limited = min(max(v, -p.slew[a]), p.slew[a])
    ds[I0 + a] = limited - r * i
    if p.coil == 1:
        ds[F0 + a] = w * w / gain * (drive - f)
        ds[V0 + a] = w * w / gain * (limited - s[V0 + a])
    else:
        ds[F0 + a] = s[V0 + a]
        ds[V0 + a] = w * w * (drive - f) - damped * s[V0 + a]


@njit(cache=True, fastmath=FAST, inline="always")
def _amplifier(p, a, t, s, u, ds):
    """Current of axis a, driven by what u becomes on its way.

    Crosstalk, hum, dead band and limit, a cable's resonance, a third pole, a slew limit.
    """
    i = s[I0 + a]
    drive = 0.0
    for b in range(4):
        drive += p.u_mix[a, b] * u[b]
    if p.hum_a[a] != 0.0:
        drive += p.hum_a[a] * np.cos(2 * np.pi * p.hum_hz * t + p.hum_phase + 0.7 * a)
    if p.dead_band[a] > 0.0:
        drive = np.sign(drive) * max(0.0, abs(drive) - p.dead_band[a])
    drive = min(max(drive, -p.drive_limit[a]), p.drive_limit[a])
    ds[C0 + a] = ds[C0 + 4 + a] = 0.0
    if p.cable_share[a] > 0.0:
        c, v = s[C0 + a], s[C0 + 4 + a]
        ds[C0 + a] = v
        ds[C0 + 4 + a] = p.cable_w**2 * (drive - c) - 2.0 * p.cable_zeta * p.cable_w * v
        drive += p.cable_share[a] * (c - drive)
    drive *= p.amp_gain[a]
    ds[P0 + a] = 0.0
    if p.amp_extra[a] > 0.0:
        ds[P0 + a] = p.amp_extra[a] * (drive - s[P0 + a])
        drive = s[P0 + a]
    ds[F0 + a] = 0.0
    if p.coil > 0:
        _coil(p, a, drive, s, ds)
        return
    rate = s[V0 + a]
    if p.slew[a] < 1e30:
        rate = min(max(rate, -p.slew[a] - p.slew_resistive[a] * i), p.slew[a] - p.slew_resistive[a] * i)
    ds[I0 + a] = rate
    ds[V0 + a] = p.amp_w[a] ** 2 * (drive - i) - 2.0 * p.amp_zeta[a] * p.amp_w[a] * rate


@njit(cache=True, fastmath=FAST, inline="always")
def _restoring(p, s, ds):
    """Springs and dampers of the modes and housings."""
    for plane in range(2):
        for j in range(p.nq):
            n = plane * NQ + j
            q, v, w = s[n], s[14 + n], p.w[plane, j]
            ds[n] = v
            if w > 0.0:
                ds[14 + n] -= w * w * q * (1.0 + p.cubic[plane, j] * q * q)
                ds[14 + n] -= 2.0 * p.zeta[plane, j] * w * v * (1.0 + p.square_damping[plane, j] * q * q)


@njit(cache=True, fastmath=FAST, inline="always")
def _turning(p, s, ds):
    """What couples the planes of a rotor that turns, and what turns with it.

    Complex r = x + i y: I r'' - i W G r' of the tilting rotor, -c (r' - i W r) of damping that turns with the shaft,
    i k r of a seal. The rotor is balanced.
    """
    w = p.spin
    for j in range(p.nq):
        x, y, vx, vy = s[j], s[NQ + j], s[14 + j], s[14 + NQ + j]
        fx = -p.inner[j] * (vx + w * y)
        fy = -p.inner[j] * (vy - w * x)
        for k in range(p.nq):
            fx -= w * p.gyro[j, k] * s[14 + NQ + k]
            fy += w * p.gyro[j, k] * s[14 + k]
        ds[14 + j] += p.minv[0, j] * fx
        ds[14 + NQ + j] += p.minv[1, j] * fy
    for m in range(3):
        xs = 0.0
        ys = 0.0
        for j in range(p.nq):
            xs += p.seal_at[m, j] * s[j]
            ys += p.seal_at[m, j] * s[NQ + j]
        k = p.seal[m] + w * p.seal_by_speed[m]
        for j in range(p.nq):
            ds[14 + j] -= p.minv[0, j] * p.seal_at[m, j] * k * ys
            ds[14 + NQ + j] += p.minv[1, j] * p.seal_at[m, j] * k * xs


@njit(cache=True, fastmath=FAST)
def derivative(p, t, s, u, plays, drift_k, drift_gap, ds):
    """ds/dt of the whole plant for a constant u (4,)."""
    for plane in range(2):
        for j in range(p.nq):
            ds[14 + plane * NQ + j] = 0.0
    for a in range(4):
        plane, end = a // 2, a % 2
        x = 0.0
        v = 0.0
        for j in range(p.nq):
            x += p.tb[plane, end, j] * s[plane * NQ + j]
            v += p.tb[plane, end, j] * s[14 + plane * NQ + j]
        i = s[I0 + a]
        ie = _play(i, plays[a], p.play_share[a], p.play_width)
        xe = x
        if p.ladder > 0:
            base = L0 + a * N_LADDER
            out = p.ladder_direct * ie
            for m in range(N_LADDER):
                out += p.ladder_gain[m] * s[base + m]
                ds[base + m] = p.ladder_pole[m] * (ie - s[base + m])
            ie = out
            if p.ladder == 2:
                base += 4 * N_LADDER
                out = p.ladder_direct * x
                for m in range(N_LADDER):
                    out += p.ladder_gain[m] * s[base + m]
                    ds[base + m] = p.ladder_pole[m] * (x - s[base + m])
                xe = out
        swing = 0.0
        if p.ks_swing != 0.0:
            swing = p.ks_swing * np.cos(2 * np.pi * p.ks_swing_hz * t)
        f = magnet_force(p, a, ie, xe, drift_k, drift_gap, swing)
        depth = 0.0
        if x > p.stop_gap[a]:
            depth = x - p.stop_gap[a]
        elif p.stop_both and x < -p.stop_gap[a]:
            depth = x + p.stop_gap[a]
        if depth != 0.0:  # Hunt-Crossley: no glue when it leaves
            f -= p.stop_stiffness * depth * max(0.0, 1.0 + p.stop_damping * v * np.sign(depth))
        f -= p.ring_cubic[a] * x**3 + p.ring_damping[a] * v
        ds[Z0 + a] = 0.0
        if p.friction[a] > 0.0:  # Dahl's presliding friction: sticks below its force, slips at it
            pull = p.friction_stiffness * s[Z0 + a]
            ds[Z0 + a] = v - abs(v) * pull / p.friction[a]
            f -= pull
        for b in range(4):
            share = p.force_mix[b, a] * f
            if share != 0.0:
                for j in range(p.nq):
                    ds[14 + (b // 2) * NQ + j] += p.minv[b // 2, j] * p.tb[b // 2, b % 2, j] * share
        # sensor
        ds[S0 + a] = 0.0
        if p.sensor_w[a] > 0.0:
            xs = 0.0
            for j in range(p.nq):
                xs += p.ts[plane, end, j] * s[plane * NQ + j]
            ds[S0 + a] = p.sensor_w[a] * (xs - s[S0 + a])
        _amplifier(p, a, t, s, u, ds)
    _restoring(p, s, ds)
    if p.spin != 0.0 or p.seal.any() or p.inner.any():
        _turning(p, s, ds)


@njit(cache=True, fastmath=FAST, inline="always")
def _rk4(p, t, s, u, plays, dk, dg, h, n, work):
    k1, k2, k3, k4, x = work[0], work[1], work[2], work[3], work[4]
    derivative(p, t, s, u, plays, dk, dg, k1)
    for j in range(n):
        x[j] = s[j] + 0.5 * h * k1[j]
    derivative(p, t + 0.5 * h, x, u, plays, dk, dg, k2)
    for j in range(n):
        x[j] = s[j] + 0.5 * h * k2[j]
    derivative(p, t + 0.5 * h, x, u, plays, dk, dg, k3)
    for j in range(n):
        x[j] = s[j] + h * k3[j]
    derivative(p, t + h, x, u, plays, dk, dg, k4)
    for j in range(n):
        s[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
    for a in range(4):
        if p.play_share[a] > 0.0:
            for j in range(N_PLAYS):
                i = s[I0 + a]
                plays[a, j] = max(i - p.play_width[j], min(i + p.play_width[j], plays[a, j]))


@njit(cache=True, fastmath=FAST, inline="always")
def _sensed(p, s, a, out):
    """Displacement and velocity in front of sensor a (behind its pole where it has one)."""
    plane, end = a // 2, a % 2
    x = 0.0
    v = 0.0
    for j in range(p.nq):
        x += p.ts[plane, end, j] * s[plane * NQ + j]
        v += p.ts[plane, end, j] * s[14 + plane * NQ + j]
    if p.sensor_w[a] > 0.0:
        v = p.sensor_w[a] * (x - s[S0 + a])
        x = s[S0 + a]
    out[0], out[1] = x, v


class Loop(NamedTuple):
    """Controller, sensors' outputs and delays."""

    b: np.ndarray  # (4, n) highest power of z first, a[:, 0] = 1
    a: np.ndarray
    sample_time: float
    delay: np.ndarray  # (1,) s between u and the drive
    sensor_delay: float  # s, below one sample
    sensor_gain: np.ndarray  # (4,)
    sensor_cubic: np.ndarray  # (4,) 1/m^2
    sensor_step: float  # m, 0 none
    hum_m: np.ndarray  # (4,) m
    hum_hz: float
    hum_phase: float
    runout: np.ndarray  # (2, 4) m once and twice a turn
    runout_phase: float
    spin: float  # rad/s


@njit(cache=True, fastmath=FAST)
def run_tone(
    plants, c, axis, amplitude, frequency, n_samples, ramp, t_start, dk, dg, noise_y, noise_i, substeps, limits
):
    """One tone from rest: logged r, u, i, y (n, 4), and how many samples it lasted within the limits."""
    p = plants[0]
    n = L0 if p.ladder == 0 else (L0 + 4 * N_LADDER if p.ladder == 1 else N_STATES)
    s = np.zeros(N_STATES)
    work = np.zeros((5, N_STATES))
    plays = np.zeros((4, N_PLAYS))
    order = c.b.shape[1] - 1
    z = np.zeros((4, order + 1))
    whole = int(c.delay[0] / c.sample_time)
    rest = c.delay[0] - whole * c.sample_time
    queue = np.zeros((whole + 2, 4))
    n1 = int(np.ceil(rest / c.sample_time * substeps - 1e-9))
    n2 = int(np.ceil((c.sample_time - rest) / c.sample_time * substeps - 1e-9))  # no step longer for a delay
    # times of the grid within a sample and what the sensor saw there, for its delay
    m = n1 + n2 + 1
    grid = np.zeros(m)
    for j in range(n1):
        grid[j + 1] = rest * (j + 1) / n1
    for j in range(n2):
        grid[n1 + j + 1] = rest + (c.sample_time - rest) * (j + 1) / n2
    seen = np.zeros((m, 4, 2))
    pair = np.zeros(2)
    ru, rr = np.zeros((n_samples, 4)), np.zeros((n_samples, 4))
    ri, ry = np.zeros((n_samples, 4)), np.zeros((n_samples, 4))
    u = np.zeros(4)
    for k in range(n_samples):
        t = k * c.sample_time
        for a in range(4):
            if c.sensor_delay > 0.0:
                x = 0.0
                if k > 0:
                    at = c.sample_time - c.sensor_delay
                    j = 0
                    while j < m - 2 and grid[j + 1] < at:
                        j += 1
                    h = grid[j + 1] - grid[j]
                    q = (at - grid[j]) / h
                    x = (
                        seen[j, a, 0] * (1 + 2 * q) * (1 - q) ** 2
                        + seen[j, a, 1] * h * q * (1 - q) ** 2
                        + seen[j + 1, a, 0] * q * q * (3 - 2 * q)
                        + seen[j + 1, a, 1] * h * q * q * (q - 1)
                    )
            else:
                _sensed(p, s, a, pair)
                x = pair[0]
            y = c.sensor_gain[a] * (x + c.sensor_cubic[a] * x**3) + noise_y[k, a]
            if c.hum_m[a] != 0.0:
                y += c.hum_m[a] * np.cos(2 * np.pi * c.hum_hz * (t_start + t) + c.hum_phase + 0.9 * a)
            if c.spin != 0.0:  # a y sensor sees the same mark a quarter of a turn later
                turned = c.spin * (t_start + t) + c.runout_phase - 0.5 * np.pi * (a // 2)
                y += c.runout[0, a] * np.cos(turned) + c.runout[1, a] * np.cos(2 * turned)
            if c.sensor_step > 0.0:
                y = c.sensor_step * np.round(y / c.sensor_step)
            r = 0.0
            if a == axis:
                rise = 1.0 if k >= ramp else 0.5 - 0.5 * np.cos(np.pi * k / ramp)
                r = amplitude * rise * np.cos(2 * np.pi * frequency * t)
            e = -y
            out = c.b[a, 0] * e + z[a, 0]
            for j in range(1, order + 1):
                z[a, j - 1] = c.b[a, j] * e - c.a[a, j] * out + z[a, j]
            u[a] = out + r
            rr[k, a], ru[k, a], ry[k, a] = r, u[a], y
            ri[k, a] = s[I0 + a] + noise_i[k, a]
            if abs(y) > limits[0] or abs(ri[k, a]) > limits[1] or not np.isfinite(y):
                return rr, ru, ri, ry, k
        for q in range(whole + 1, 0, -1):
            queue[q] = queue[q - 1]
        queue[0] = u
        if c.sensor_delay > 0.0:
            for a in range(4):
                _sensed(p, s, a, pair)
                seen[0, a] = pair
        for j in range(m - 1):
            drive = queue[whole + 1] if j < n1 else queue[whole]
            _rk4(p, t_start + t + grid[j], s, drive, plays, dk, dg, grid[j + 1] - grid[j], n, work)
            if c.sensor_delay > 0.0:
                for a in range(4):
                    _sensed(p, s, a, pair)
                    seen[j + 1, a] = pair
    return rr, ru, ri, ry, n_samples
