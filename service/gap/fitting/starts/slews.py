"""Starts of a voltage limit of the amplifiers: the slew limits, on a grid, with the least residuals of the current."""

from __future__ import annotations

import numpy as np

from service.gap.fitting.predict import current, linear_answer, weight
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from service.gap.measured.observation import Observation
from sim.effect import Effect
from sim.rig import Rig

SLEWS = tuple(np.geomspace(0.7, 1.02, 25).tolist())
"""Slew limits on the grid, over the largest slope of the measured fundamental: from below pi/4, as a current that is at
its limit all the time is a triangle, whose fundamental is 4/pi as steep as the limit."""
DAMPING_SHARES = (0.0, 0.5, 1.0)
"""Shares of a current loop's damping that act on the limited slope, of the kinds of loops that are tried."""


def starts(effect: Effect, _base: dict[str, float], residuals: SweepResiduals) -> list[dict[str, float]]:
    """For each kind of current loop the slew limit with the least residuals, best first.

    Near the limit a loop that winds up makes the current jump to a lag of half a period, so the minimum of the cost is
    narrow and needs a fine grid. Where the current was not logged, y does not show limits so finely, and a few do.
    """
    rig, o = residuals.rig, residuals.o
    rate, limits = largest_rate(o, rig), {p.name: p for p in effect.parameters}["slew_inverse_s_per_a"]

    def values(share: float, seen: float) -> dict[str, float]:
        inverse = float(np.clip(1 / (share * rate), limits.low, limits.high))
        return {"slew_inverse_s_per_a": inverse, "slope_seen": seen}

    if o.I is None or np.isfinite(rig.amplifiers.slew_limit_a_per_s).any():
        return [values(share, seen) for share in (0.9, np.pi / 4) for seen in (0.1, 0.9)]
    without, w = current(rig, o), weight(o, "i")
    kinds = DAMPING_SHARES[:1] if rig.amplifiers.damping_ratio is None else DAMPING_SHARES

    def remainder(parameters: dict[str, float]) -> float:
        """Chi-square that is left with such a limit."""
        change = (current(effect.on(rig, **parameters), o) - without) * w
        return float(np.sum(np.abs(residuals.z - change) ** 2))

    best = [min(((remainder(v := values(s, seen)), v) for s in SLEWS), key=lambda one: one[0]) for seen in kinds]
    return [v for _, v in sorted(best, key=lambda one: one[0])]


def largest_rate(o: Observation, rig: Rig | None = None) -> float:
    """Largest slope of the coil current's fundamental, A/s.

    Where the current was not logged it is that of the small-signal ``rig``, or else of the control signal.
    """
    if o.I is not None or rig is None:
        currents = (o.U if o.I is None else o.I)[:, o.fundamental]
    else:  # far above the amplifiers' bandwidth it is much less than the control signal's
        currents = linear_answer(rig, o)[:, : rig.n_axes]
    return float((np.abs(currents).max(axis=1) * 2 * np.pi * o.points_hz).max())
