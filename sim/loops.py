"""Hysteresis loops of a periodic current in closed form: plays of one half width, of a band of them, or of all.

A play of half width r follows a current that turns at -A and A by i - r on its way up, once it has gone 2 r, and by
i + r on its way down; one wider than A stays where it is. Over all r up to w that has a closed form, for w beyond A
Lord Rayleigh's: (1 + alpha A) i +- alpha/2 (A^2 - i^2) (Phil. Mag. 23, 1887). `sim.loop` steps the same plays through
time.
"""

from __future__ import annotations

import math

import numpy as np

from sim.actuator import denser_bands, play_band, rayleigh_coefficient
from sim.rig import Array, Magnets


def lag(m: Magnets, i_t: Array) -> Array:
    """What the iron's plays add to a current, A, (P, T, n), about the middle of its swing.

    Parameters
    ----------
    i_t
        (P, T, n) samples of a period with one maximum and one minimum, A.
    """
    top, bottom = i_t.max(axis=1, keepdims=True), i_t.min(axis=1, keepdims=True)
    swing = (top - bottom) / 2
    way = np.where(np.roll(i_t, -1, axis=1) >= np.roll(i_t, 1, axis=1), 1.0, -1.0)
    along = way * (i_t - (top + bottom) / 2)
    low, high, density = play_band(m)
    if math.isinf(density):
        added = high * one(high, along, swing)
    else:
        added = density * (up_to(high, along, swing) - up_to(low, along, swing))
    for more, inner, outer in denser_bands(m):
        added = added + more * (up_to(outer, along, swing) - up_to(inner, along, swing))
    return np.asarray(2 * rayleigh_coefficient(m) * way * added)


def one(width_a: float, i: Array, swing_a: Array) -> Array:
    """Where a play of that half width is while the current i rises from -swing to swing, A."""
    return np.where(width_a < swing_a, np.maximum(i - width_a, width_a - swing_a), 0.0)


def up_to(width_a: float, i: Array, swing_a: Array) -> Array:
    """Integral of `one` over half widths from 0 to that one, A^2."""
    if not width_a:
        return np.zeros_like(i)
    moves = np.minimum(width_a, swing_a)
    follows = np.minimum((i + swing_a) / 2, moves)
    return np.asarray((i + swing_a) * follows - follows**2 + moves**2 / 2 - swing_a * moves)
