"""Periodic steady states that only stepping through time finds, compiled: plays, and amplifiers at their slew limit."""

from __future__ import annotations

import math
from typing import NamedTuple

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
TOGETHER = 1e-5
"""Distance, relative to all that is asked for, at which two currents that began apart have become one."""

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


class _Held(NamedTuple):
    """A first-order amplifier of one axis at its limit, driven by a held signal; as `held_slewing` has them."""

    period: float
    late: float
    lag_s: float
    w: float
    limit: float
    noise: float
    steps: int


def held_slewing(
    asked: Array,
    settling: int,
    period: float,
    late: Array,
    lag_s: float,
    w: Array,
    limit: Array,
    steps: int,
    noise: Array,
) -> Array:
    """What a slew limit changes of the current of a first-order amplifier that a held signal drives, A, (K steps, n).

    What is asked for jumps with the signal, so the slope does; between, i' = clip(w (asked - i)) in closed form. At the
    samples, and in equal steps between them.

    Currents that begin apart never cross, and approach each other: between one that begins at the least and one that
    begins at the most that is ever asked for lies the steady one. As many samples are left to them before the first one
    returned as bring these two together to `TOGETHER`, ``settling`` at most.

    Parameters
    ----------
    asked : (settling + K + 1, n) current that the signal asks for in turn, A; the first one is of the sample before
    settling : most samples before the first one returned
    period : of the samples, s
    late : (n,) how long after a sample its signal acts, s, less than a period
    lag_s : time constant of a lag between signal and amplifier, s, 0 for none
    w : (n,) rad/s
    limit : (n,) A/s, inf where none acts
    steps : integration steps of a sample
    noise : (n,) root mean square of the slopes that noise asks for, A/s
    """
    change = np.zeros(((asked.shape[0] - 1 - settling) * steps, asked.shape[1]))
    for a in np.flatnonzero(np.isfinite(limit)):
        amp = _Held(period, float(late[a]), float(lag_s), float(w[a]), float(limit[a]), float(noise[a]), steps)
        linear = math.ceil(-math.log(TOGETHER) * (1 / amp.w + amp.lag_s) / period)  # until the linear one is steady
        change[:, a] = _held_slewing(np.ascontiguousarray(asked[:, a]), settling, min(linear, settling), amp)
    return change


@_compiled
def _held_slewing(asked: Array, settling: int, fewest: int, amp: _Held) -> Array:  # pragma: no cover (compiled)
    change = np.empty((asked.size - 1 - settling) * amp.steps)
    least, most, nowhere, before = asked.min(), asked.max(), change[:0], fewest
    while True:
        begin = settling - before
        low, high, free, lagged = least, most, asked[begin], asked[begin]
        for k in range(begin, settling):
            low, _, _ = _over_sample(low, free, lagged, asked[k], asked[k + 1], amp, nowhere)
            high, free, lagged = _over_sample(high, free, lagged, asked[k], asked[k + 1], amp, nowhere)
        if high - low <= TOGETHER * (most - least) or before == settling:
            break
        before = min(2 * before, settling)
    i = 0.5 * (low + high)
    for k in range(settling, asked.size - 1):
        filled = change[(k - settling) * amp.steps : (k - settling + 1) * amp.steps]
        i, free, lagged = _over_sample(i, free, lagged, asked[k], asked[k + 1], amp, filled)
    return change


@_compiled
def _over_sample(
    i: float, free: float, lagged: float, old: float, new: float, amp: _Held, change: Array
) -> tuple[float, float, float]:  # pragma: no cover (compiled)
    """The current, the one without a limit and the lag's output a sample later; ``change``, unless empty, is filled."""
    h = amp.period / amp.steps
    falls = np.exp(-amp.w * h)
    for s in range(amp.steps):
        if change.size:
            change[s] = i - free
        still = min(max(amp.late - s * h, 0.0), h)
        for part in range(2):
            goal, time = (old, still) if part == 0 else (new, h - still)
            if time == 0.0:
                continue
            if amp.lag_s > 0.0:
                kept = np.exp(-time / amp.lag_s)
                mean = goal + (lagged - goal) * (1.0 - kept) * amp.lag_s / time
                lagged = goal + (lagged - goal) * kept
            else:
                mean = goal
            left = falls if time == h else np.exp(-amp.w * time)
            free = mean + (free - mean) * left
            slope = amp.w * (mean - i)
            if amp.noise > 0.0:
                begins = _taken(slope, amp.limit, amp.noise)
                ends = _taken(slope * left - begins * time, amp.limit, amp.noise)
                i = mean + (i - mean) * left + 0.5 * time * (begins * left + ends)
                continue
            if abs(slope) > amp.limit:
                at_limit = min((abs(slope) / amp.limit - 1.0) / amp.w, time)
                i += np.copysign(amp.limit, slope) * at_limit
                left = np.exp(-amp.w * (time - at_limit))
            i = mean + (i - mean) * left
    return i, free, lagged


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
