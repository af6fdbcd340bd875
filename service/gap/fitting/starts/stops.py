"""Starts of a stop that the rotor touches: the clearances, on a grid, whose force matches the residuals best."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from service.gap.fitting.predict import weight, whole_displacement
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from sim.effect import Effect

CLEARANCES = (0.3, 0.45, 0.6, 0.75, 0.9)
"""Clearances on the grid, as shares of each axis's largest displacement."""
SOFT = 0.02
"""Stiffness of the trial stop over the magnets': small enough for the response to be proportional to it."""


def starts(effect: Effect, base: dict[str, float], residuals: SweepResiduals, count: int = 2) -> list[dict[str, float]]:
    """The best clearances and sides, each with its best stiffness; first with a stop in one axis, if that is better.

    For the measured motion the force of a stop is proportional to its stiffness, so the response of one soft stop gives
    the best stiffness of a clearance by linear regression.
    """
    rig, o = residuals.rig, residuals.o
    if rig.contact is not None:
        return [base]
    swing = np.abs(o.Y[:, o.fundamental]).max(axis=0)
    soft = SOFT * float(np.max(rig.magnets.ks))
    known = {p.name: p for p in effect.parameters}
    limits, names = known["stiffness_n_per_m"], [f"clearance_{axis}_m" for axis in rig.axes]
    without, w = whole_displacement(rig, o), weight(o, "y")

    def found(where: Sequence[str]) -> list[tuple[float, dict[str, float]]]:
        """(chi-square that it takes off, parameters) of stops in some axes, best first."""
        out = []
        for share, side in product(CLEARANCES, (0.0, 1.0, -1.0)):
            clearances = {
                name: float(np.clip(share * s, known[name].low, known[name].high))
                if name in where
                else known[name].high
                for name, s in zip(names, swing, strict=True)
            }
            values = {**base, **clearances, "side": 0.9 * side, "stiffness_n_per_m": max(soft, limits.low)}
            change = (whole_displacement(effect.on(rig, **values), o) - without) * w
            power = float(np.vdot(change, change).real)
            along = float(np.vdot(change, residuals.z).real)
            if along <= 0 or power <= 0:
                continue
            stiffness = values["stiffness_n_per_m"] * along / power
            values["stiffness_n_per_m"] = float(np.clip(stiffness, limits.low, limits.high))
            out.append((along**2 / power, values))
        return sorted(out, key=lambda one: -one[0])

    everywhere = found(names)
    alone = max((best for name in names for best in found([name])[:1]), key=lambda one: one[0], default=None)
    chosen = everywhere[:count]
    if alone is not None and alone[0] > max((gain for gain, _ in chosen), default=0.0):
        chosen = [alone, *chosen]
    return [values for _, values in chosen] or [base]
