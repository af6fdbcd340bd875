"""Periodic steady states that only stepping through time finds, compiled: plays, and amplifiers at their slew limit."""

from __future__ import annotations

import numba
import numpy as np

from sim.rig import Array

MOST_PERIODS = 40
"""Most periods for a current loop to settle: one that winds up is slow."""
SETTLED = 1e-4
"""Change from period to period, relative to the largest swing that the limit lets through, that counts as settled."""

_compiled = numba.njit(cache=True, nogil=True)


@_compiled
def play(i: Array, width: float) -> Array:  # pragma: no cover (compiled)
    """One play of half width ``width`` over periods i (P, T, n), about the middle of each; the second one is steady."""
    points, steps, axes = i.shape
    out = np.empty_like(i)
    for p in range(points):
        for a in range(axes):
            middle = (i[p, :, a].max() + i[p, :, a].min()) / 2
            position = 0.0
            for t in range(2 * steps):
                now = i[p, t % steps, a] - middle
                position = min(max(position, now - width), now + width)
                out[p, t % steps, a] = position
    return out


@_compiled
def slewing(
    asked: Array, dt: Array, w: Array, damping: Array, seen: float, limit: Array
) -> Array:  # pragma: no cover (compiled)
    """What a slew limit takes off the slopes that are asked of an amplifier, A/s, (P, T, n).

    With dv, what the limit changes, i' = v + dv and v' = -w^2 i - damping (v + seen dv), or v = -w i where the
    damping is 0: a first-order amplifier. Implicit in the amplifier's own loop, so that no step is too long for it.

    Parameters
    ----------
    asked : (P, T, n) slopes of the current over a period without limit, A/s
    dt : (P,) step, s
    w, damping : (n,) rad/s
    seen : share of dv that the amplifier's damping sees
    limit : (n,) A/s
    """
    points, steps, axes = asked.shape
    taken = np.zeros_like(asked)
    for p in range(points):
        for a in range(axes):
            i, v, d, most = 0.0, 0.0, dt[p], limit[a]
            stiff = 1 + d * damping[a] + (d * w[a]) ** 2
            for _ in range(MOST_PERIODS):
                begun = i
                for t in range(steps):
                    slope = asked[p, t, a] + (v if damping[a] else -w[a] * i)
                    dv = min(max(slope, -most), most) - slope
                    taken[p, t, a] = dv
                    if damping[a]:
                        v = (v - d * (w[a] ** 2 * (i + d * dv) + damping[a] * seen * dv)) / stiff
                        i = i + d * (v + dv)
                    else:
                        i = (i + d * dv) / (1 + d * w[a])
                if abs(i - begun) < SETTLED * most * steps * d / (2 * np.pi):
                    break
    return taken
