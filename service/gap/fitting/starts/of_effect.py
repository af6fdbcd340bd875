"""Starting values of any effect; several where its answer has several valleys, of which a fit finds its own only.

A resonance starts where the twin fails most, a slew limit at the largest rate of current, a stop at the clearance
whose force answers best to the residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product

import numpy as np

from service.gap.fitting.starts import drifts, resonances, slews, stops
from service.gap.fitting.starts.left import Left
from sim import imbalance
from sim.effect import Effect

Start = dict[str, float]
Search = Callable[[Effect, Start, Left], list[Start]]

FAINT = 0.2
"""Share of its typical strength at which an effect starts that nothing else is known of."""


def starts(effect: Effect, left: Left) -> list[Start]:
    """Values of all of the effect's parameters, by name, to begin a fit from, the best first.

    ``left`` is what the effect is to explain, of the part that it acts in.
    """
    effect = effect.of(left.ground.nuisance.rig)
    base = {
        p.name: p.typical if p.scale == "log" or not p.strength else p.null + FAINT * (p.typical - p.null)
        for p in effect.parameters
    }
    search = SEARCHES.get(effect.id)
    return [base] if search is None else search(effect, base, left)


def _sides(_: Effect, base: Start, left: Left) -> list[Start]:
    """The largest change is stated: on which side of the bearings that is, is another valley."""
    sides = product(*((0.0, -0.5) for name in imbalance.NAMES[: left.rig.n_planes]))
    return [{**base, **dict(zip(imbalance.NAMES, side, strict=False))} for side in sides]


def _lags(_: Effect, base: Start, __: Left) -> list[Start]:
    """Eddy currents as typical, and slow ones that end within the band."""
    return [base, {**base, "time_constant_s": 1e-5, "corner_rad_s": 2e4}]


def _laws_of_flux(effect: Effect, base: Start, _: Left) -> list[Start]:
    """Saturation by the current, and by several shares of the flux."""
    saturation = next(p for p in effect.parameters if p.name == "saturation_inverse_per_a")
    by_flux = {"saturation_inverse_per_a": saturation.low, "flux_power": 5.0}
    return [{**base, "flux_share": 0.0}, *({**base, **by_flux, "flux_share": share} for share in (0.35, 0.5, 0.7))]


def _loops(_: Effect, base: Start, left: Left) -> list[Start]:
    """Loops of hysteresis of any width, and about those that the measured swing of the flux goes through."""
    o = left.o
    swing = float(np.quantile(np.abs(o.U if o.I is None else o.I)[:, o.fundamental].max(axis=1), 0.9))
    middles = (0.25 * swing, 0.6 * swing)
    return [base, *({**base, "narrowest_a": 0.5 * m, "widest_inverse_per_a": 1 / (1.5 * m)} for m in middles)]


def _both_ways(_: Effect, base: Start, __: Left) -> list[Start]:
    return [{name: sign * v for name, v in base.items()} for sign in (1.0, -1.0)]


SEARCHES: Mapping[str, Search] = {
    "amplifier_bandwidth": _sides,
    "amplifier_voltage_limit": slews.starts,
    "eddy_currents": _lags,
    "extra_flexible_mode": resonances.starts,
    "magnetic_hysteresis": _loops,
    "magnetic_saturation": _laws_of_flux,
    "off_centre_rotor": _both_ways,
    "support_resonance": resonances.starts,
    "thermal_drift": drifts.starts,
    "touchdown_contact": stops.starts,
}
"""By effect, how its starts are found; another's is where it is faint."""
