"""Periodic steady states that only stepping through time finds, compiled: plays, and amplifiers at their slew limit."""

from __future__ import annotations

import numba
import numpy as np
import scipy.linalg
import scipy.special
from numpy.typing import NDArray

from sim.rig import Array

Mask = NDArray[np.bool_]

MOST_PERIODS = 40
"""Most periods for a current loop to settle: one that winds up is slow."""
SETTLED = 1e-4
"""Change from period to period, relative to the largest swing that the limit lets through, that counts as settled."""

_compiled = numba.njit(cache=True, nogil=True)


@_compiled
def played(i: Array, weights: Array, half_widths: Array) -> Array:  # pragma: no cover (compiled)
    """Weighted sum of plays over periods i (P, T, n), about the middle of each; the second one is steady."""
    points, steps, axes = i.shape
    out = np.zeros_like(i)
    for p in range(points):
        for a in range(axes):
            middle = (i[p, :, a].max() + i[p, :, a].min()) / 2
            swing = i[p, :, a].max() - middle
            for k in range(weights.size):
                width, weight, position = half_widths[k], weights[k], 0.0
                if width >= swing:
                    continue
                for t in range(2 * steps):
                    now = i[p, t % steps, a] - middle
                    position = min(max(position, now - width), now + width)
                    if t >= steps:
                        out[p, t - steps, a] += weight * position
    return out


@_compiled
def _taken(slope: float, limit: float, noise: float) -> float:  # pragma: no cover (compiled)
    """What a limit takes off a slope in the mean over Gaussian noise that comes with it, E[clip(slope + n)] - slope.

    The statistical linearisation of a saturation with a bias (Booton, IRE Trans. Circuit Theory 1, 1954, pp. 9-18).
    ``noise`` is the standard deviation, 0 for none.
    """
    if noise == 0.0:
        return min(max(slope, -limit), limit) - slope
    return noise * (_beyond((-limit - slope) / noise) - _beyond((slope - limit) / noise))


_FAR, _PER_UNIT = 4.5, 256.0
_AT = np.arange(int(2 * _FAR * _PER_UNIT) + 2) / _PER_UNIT - _FAR
_BEYOND: Array = np.exp(-0.5 * _AT**2) / np.sqrt(2 * np.pi) + 0.5 * _AT * scipy.special.erfc(-_AT / np.sqrt(2))
"""E[max(x + n, 0)] at x = `_AT`: it is slow to compute, and is asked for at every step in time."""


@_compiled
def _beyond(x: float) -> float:  # pragma: no cover (compiled)
    """E[max(x + n, 0)] for n ~ N(0, 1), to 1e-6: between two values of `_BEYOND` in a straight line."""
    if abs(x) >= _FAR:
        return max(x, 0.0)
    place = (x + _FAR) * _PER_UNIT
    k = int(place)
    return float(_BEYOND[k] + (place - k) * (_BEYOND[k + 1] - _BEYOND[k]))


def slewing(
    asked: Array,
    dt: Array,
    w: Array,
    damping: Array,
    seen: float,
    limit: Array,
    opposed: bool,
    noise: Array | float = 0.0,
    reached: Mask | None = None,
) -> Array:
    """What a slew limit takes off the slopes that are asked of a second-order amplifier, A/s, (P, T, n).

    With dv, what the limit changes, i' = v + dv and v' = -w^2 i - damping (v + seen dv). The amplifier's own loop is
    stepped exactly, so that no step is too long for it; dv goes in a straight line from step to step.

    Parameters
    ----------
    asked : (P, T, n) slopes of the current over a period without limit, A/s
    dt : (P,) step, s
    w, damping : (n,) rad/s
    seen : share of dv that the amplifier's damping sees
    limit : (n,) A/s
    opposed : whether the loop begins with a current opposed to the one without limit, instead of with that one. A loop
        that winds up may settle in two ways beyond its limit: it lags a little, or by half a period.
    noise : (n,) or one for all, root mean square of the slopes that noise asks for, A/s
    reached : (P, n) where the limit acts, everywhere by default; elsewhere it takes off nothing
    """
    A = np.zeros((w.size, 3, 3))  # of i, v, and dv held
    A[:, 0, 1] = A[:, 0, 2] = 1.0
    A[:, 1] = np.stack([-(w**2), -damping, -damping * seen], axis=-1)
    own, of_point = np.unique(dt, return_inverse=True)  # every axis is driven at a line in turn
    over = scipy.linalg.expm(A * own[:, None, None, None])[of_point]
    begin = np.zeros((2, *dt.shape, w.size))
    if opposed:
        t = np.arange(asked.shape[1])[:, None] * (dt / asked.shape[1])[:, None, None]
        begin[0] = -2 * (asked * t).sum(axis=1)  # of a current that has these slopes, and no mean
        begin[1] = -2 * asked[:, 0]
    swing = limit * (asked.shape[1] * dt / (2 * np.pi))[:, None]
    rms = np.broadcast_to(np.asarray(noise, dtype=float), w.shape).copy()
    acts = np.ones(swing.shape, dtype=bool) if reached is None else reached
    return np.asarray(_slewing(asked, over, limit, acts, swing, begin[0], begin[1], rms))


@_compiled
def held_slewing(
    asked: Array, period: float, late: Array, lag_s: float, w: Array, limit: Array, steps: int, noise: Array
) -> Array:  # pragma: no cover (compiled)
    """What a slew limit changes of the current of a first-order amplifier that a held signal drives, A, (K steps, n).

    What is asked for jumps with the signal, so the slope does; between, i' = clip(w (asked - i)) in closed form. Begun
    without a change; at the samples, and in equal steps between them.

    Parameters
    ----------
    asked : (K + 1, n) current that the signal asks for in turn, A; the first one is of the sample before
    period : of the samples, s
    late : (n,) how long after a sample its signal acts, s, less than a period
    lag_s : time constant of a lag between signal and amplifier, s, 0 for none
    w : (n,) rad/s
    limit : (n,) A/s, inf where none acts
    steps : integration steps of a sample
    noise : (n,) root mean square of the slopes that noise asks for, A/s
    """
    samples, axes = asked.shape[0] - 1, asked.shape[1]
    h = period / steps
    change = np.zeros((samples * steps, axes))
    for a in range(axes):
        if not limit[a] < np.inf:
            continue
        falls = np.exp(-w[a] * h)
        lagged = i = free = asked[0, a]
        for k in range(samples):
            for s in range(steps):
                change[k * steps + s, a] = i - free
                old = min(max(late[a] - s * h, 0.0), h)
                for part in range(2):
                    goal, time = (asked[k, a], old) if part == 0 else (asked[k + 1, a], h - old)
                    if time == 0.0:
                        continue
                    if lag_s > 0.0:
                        kept = np.exp(-time / lag_s)
                        mean = goal + (lagged - goal) * (1.0 - kept) * lag_s / time
                        lagged = goal + (lagged - goal) * kept
                    else:
                        mean = goal
                    left = falls if time == h else np.exp(-w[a] * time)
                    free = mean + (free - mean) * left
                    slope = w[a] * (mean - i)
                    if noise[a] > 0.0:
                        begins = _taken(slope, limit[a], noise[a])
                        ends = _taken(slope * left - begins * time, limit[a], noise[a])
                        i = mean + (i - mean) * left + 0.5 * time * (begins * left + ends)
                        continue
                    if abs(slope) > limit[a]:
                        at_limit = min((abs(slope) / limit[a] - 1.0) / w[a], time)
                        i += np.copysign(limit[a], slope) * at_limit
                        left = np.exp(-w[a] * (time - at_limit))
                    i = mean + (i - mean) * left
    return change


@_compiled
def _slewing(
    asked: Array, over: Array, limit: Array, reached: Mask, swing: Array, i0: Array, v0: Array, noise: Array
) -> Array:  # pragma: no cover (compiled)
    points, steps, axes = asked.shape
    taken = np.zeros_like(asked)
    for p in range(points):
        for a in range(axes):
            if not reached[p, a]:
                continue
            i, v, most, S = i0[p, a], v0[p, a], limit[a], over[p, a]
            for _ in range(MOST_PERIODS):
                begun = i
                for t in range(steps):
                    slope = asked[p, t, a] + v
                    now = _taken(slope, most, noise[a])
                    ahead = asked[p, (t + 1) % steps, a] + S[1, 0] * i + S[1, 1] * v + S[1, 2] * now
                    between = (now + _taken(ahead, most, noise[a])) / 2
                    i, v = S[0, 0] * i + S[0, 1] * v + S[0, 2] * between, S[1, 0] * i + S[1, 1] * v + S[1, 2] * between
                    taken[p, t, a] = now
                if abs(i - begun) < SETTLED * swing[p, a]:
                    break
    return taken
