"""Periodic steady states that only stepping through time finds, compiled: plays, and amplifiers at their slew limit."""

from __future__ import annotations

import numba
import numpy as np
import scipy.linalg

from sim.rig import Array

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


def slewing(asked: Array, dt: Array, w: Array, damping: Array, seen: float, limit: Array, opposed: bool) -> Array:
    """What a slew limit takes off the slopes that are asked of an amplifier, A/s, (P, T, n).

    With dv, what the limit changes, i' = v + dv and v' = -w^2 i - damping (v + seen dv), or v = -w i where the
    damping is 0: a first-order amplifier. The amplifier's own loop is stepped exactly, so that no step is too long for
    it; dv goes in a straight line from step to step.

    Parameters
    ----------
    asked : (P, T, n) slopes of the current over a period without limit, A/s
    dt : (P,) step, s
    w, damping : (n,) rad/s
    seen : share of dv that the amplifier's damping sees
    limit : (n,) A/s
    opposed : whether the loop begins with a current opposed to the one without limit, instead of with that one. A loop
        that winds up may settle in two ways beyond its limit: it lags a little, or by half a period.
    """
    first = damping == 0
    c, share = np.where(first, w, damping), np.where(first, 1.0, seen)
    A = np.zeros((w.size, 3, 3))  # of i, v, and dv held
    A[:, 0, 1] = A[:, 0, 2] = 1.0
    A[:, 1] = np.stack([np.where(first, 0.0, -(w**2)), -c, -c * share], axis=-1)
    over = scipy.linalg.expm(A * dt[:, None, None, None])
    begin = np.zeros((2, *dt.shape, w.size))
    if opposed:
        t = np.arange(asked.shape[1])[:, None] * (dt / asked.shape[1])[:, None, None]
        begin[0] = -2 * (asked * t).sum(axis=1)  # of a current that has these slopes, and no mean
        begin[1] = np.where(first, -w * begin[0], -2 * asked[:, 0])
    swing = limit * (asked.shape[1] * dt / (2 * np.pi))[:, None]
    return np.asarray(_slewing(asked, over, limit, swing, begin[0], begin[1]))


@_compiled
def _slewing(
    asked: Array, over: Array, limit: Array, swing: Array, i0: Array, v0: Array
) -> Array:  # pragma: no cover (compiled)
    points, steps, axes = asked.shape
    taken = np.zeros_like(asked)
    for p in range(points):
        for a in range(axes):
            i, v, most, S = i0[p, a], v0[p, a], limit[a], over[p, a]
            for _ in range(MOST_PERIODS):
                begun = i
                for t in range(steps):
                    slope = asked[p, t, a] + v
                    now = min(max(slope, -most), most) - slope
                    ahead = asked[p, (t + 1) % steps, a] + S[1, 0] * i + S[1, 1] * v + S[1, 2] * now
                    between = (now + min(max(ahead, -most), most) - ahead) / 2
                    i, v = S[0, 0] * i + S[0, 1] * v + S[0, 2] * between, S[1, 0] * i + S[1, 1] * v + S[1, 2] * between
                    taken[p, t, a] = now
                if abs(i - begun) < SETTLED * swing[p, a]:
                    break
    return taken
