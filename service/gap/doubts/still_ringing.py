"""Lines at which the rig still rang, where most of what a part's best twin leaves lies.

Of a narrow resonance that the plan did not know of no wait was long enough, and blocks that are short beside its decay
change by a small part of what is still to come: what is left there may be the transient, which no twin predicts.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from service.gap.fitting.part import Ground
from service.gap.measured.observation import Observation
from service.gap.which.explained import Explained

PLAIN = 300.0
"""Least excess of a part for it, in squared residuals over their expectation."""
RESTLESS = 0.01
"""Change of a point from its first block to its last, relative to its size, from which it rings."""
SHARE_OF_RESTLESS_LINES = 0.5
"""Share of a part's excess that lines with such points must have."""
SHARE_OF_WORST = 0.1
"""Excess of a point, relative to the largest, from which its line is named."""
LARGEST_LEFT_OUT = 3
"""Lines at most that are left out of a second search: where the rig rang at more, it is not one narrow resonance."""


def ringing_lines_hz(e: Explained) -> list[float]:
    """Lines with most of what the best twin leaves of a part on the main sweep, at which the rig still rang, Hz."""
    o, power = e.ground.observations[0], np.abs(e.left[0]) ** 2 / 2
    excess = np.maximum(power.sum(axis=(1, 2)) - np.count_nonzero(power, axis=(1, 2)), 0.0)
    restless = np.isin(o.line, o.line[o.drifting & (o.drift > RESTLESS)])
    if excess.sum() <= PLAIN or excess[restless].sum() <= SHARE_OF_RESTLESS_LINES * excess.sum():
        return []
    return sorted({float(hz) for hz in o.points_hz[restless & (excess > SHARE_OF_WORST * excess.max())]})


def hertz(lines_hz: Iterable[float]) -> str:
    """Frequencies in words.

    >>> hertz([115.83, 20.0])
    '20, 115.8 Hz'
    """
    return f"{', '.join(f'{hz:.4g}' for hz in sorted(lines_hz))} Hz"


def without_lines(ground: Ground, lines_hz: list[float]) -> Ground:
    """The ground with the displacements of some lines of the main sweep, of any axis, left out of every fit."""
    main, *others = ground.observations
    return replace(ground, observations=(_without(main, lines_hz), *others))


def _without(o: Observation, lines_hz: list[float]) -> Observation:
    sd_y = o.sd_y.copy()
    sd_y[np.isin(o.points_hz, lines_hz)] = np.inf
    return replace(o, sd_y=sd_y)
