"""The speed of a rotor while it is measured: which speeds count as one, and what is said of one that changed."""

from __future__ import annotations

import numpy as np

from service.experiment.data import Experiment, Sweep
from sim.datasheet import FASTEST_RAD_S

SPEED_APART, SPEED_APART_RAD_S = 0.01, 1.0
"""How far speeds may be apart that count as one: a share of it, and rad/s."""
SPEED_CHANGED = "speed_changed"
"""Attribute of a file whose rotor turned otherwise when the campaign had ended: from which speed to which."""
FEW_LINES = 6
"""Lines at another speed up to which each is told."""


def impossible(speed_rad_s: float) -> str:
    """Why no rotor turns at a speed, whichever way, to follow what stated it; empty where one may.

    >>> impossible(-1e9)
    'is -1e+09 rad/s, and no rotor turns beyond 6e+04 rad/s: check it and its unit'
    >>> impossible(6000.0)
    ''
    """
    if abs(speed_rad_s) <= FASTEST_RAD_S:
        return ""
    return f"is {speed_rad_s:.3g} rad/s, and no rotor turns beyond {FASTEST_RAD_S:.3g} rad/s: check it and its unit"


def same(one_rad_s: float, other_rad_s: float) -> bool:
    """Whether two speeds, and the ways in which the shaft turns, count as one.

    >>> same(314.0, 316.0), same(314.0, -314.0), same(0.0, -0.5)
    (True, False, True)
    """
    return abs(other_rad_s - one_rad_s) <= SPEED_APART_RAD_S + SPEED_APART * abs(other_rad_s)


def alike(one_rad_s: float, other_rad_s: float) -> bool:
    """Whether two speeds, whichever way the shaft turns, count as one.

    >>> alike(314.0, -316.0), alike(0.0, 314.0)
    (True, False)
    """
    return same(abs(one_rad_s), abs(other_rad_s))


def at_standstill(speed_rad_s: float) -> bool:
    """Whether a speed counts as none: a controller tells a little of a rotor that rests, too.

    >>> at_standstill(0.02), at_standstill(-3.0)
    (True, False)
    """
    return same(speed_rad_s, 0.0)


def changed_speed(experiment: Experiment) -> list[str]:
    """That the rotor's speed changed while the experiment was measured, in a sentence; at which lines, where known."""
    found = [told for sweep in experiment.sweeps if (told := _elsewhere(sweep))]
    if found:
        return [
            f"the rotor turned at another speed than the sweep's at {'; at '.join(found)}: what goes by the speed, as "
            "gyroscopic coupling and runout, is wrong by that there; measure at one speed"
        ]
    how = experiment.attributes.get(SPEED_CHANGED)
    if how is None:
        return []
    return [
        f"the rotor's speed changed {how} while it was measured, and every point is taken for one at the first: what "
        "goes by the speed, as gyroscopic coupling and runout, is wrong by that; measure at one speed"
    ]


def _elsewhere(sweep: Sweep) -> str:
    """Which points of a sweep were measured at another speed than its own, and at which; "" where none was."""
    if sweep.point_speed_rad_s is None:
        return ""
    away = np.array([not same(sweep.speed_rad_s, w) for w in sweep.point_speed_rad_s.tolist()])
    if not away.any():
        return ""
    lines = np.unique(sweep.frequency_hz[away])
    where = ", ".join(f"{f:.4g}" for f in lines) if len(lines) <= FEW_LINES else f"{lines[0]:.4g} to {lines[-1]:.4g}"
    slowest, fastest = (f"{f(sweep.point_speed_rad_s[away]):.4g}" for f in (np.min, np.max))
    speeds = slowest if slowest == fastest else f"{slowest} to {fastest}"
    name = f" of {sweep.comment}" if sweep.comment else ""
    return (
        f"{away.sum()} of {sweep.n_points} points{name} ({where} Hz: {speeds} rad/s in place of "
        f"{sweep.speed_rad_s:.4g})"
    )
