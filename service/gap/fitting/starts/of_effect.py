"""Starting values of any effect; several where the cost has several local minima, of which a fit finds the nearest.

A resonance starts where the residuals are largest, a slew limit near the largest slope of the current, a stop at the
clearance whose force matches the residuals best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product

import numpy as np

from service.gap.fitting.starts import drifts, resonances, slews, stops
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from sim import imbalance
from sim.effect import Effect
from sim.errors import EffectError

Start = dict[str, float]
Search = Callable[[Effect, Start, SweepResiduals], list[Start]]

FAINT = 0.2
"""Share of its typical strength at which an effect starts by default."""


def starts(effect: Effect, residuals: SweepResiduals) -> list[Start]:
    """Starts of a fit, all of the effect's parameters by name, the best first.

    ``residuals`` are those that the effect is to explain, of the part that it acts in. Where the fitted twin cannot
    have what a search tries on it, as its air gap is another than the datasheet's, the default start is the only one.
    """
    effect = effect.of(residuals.ground.nuisance.rig)
    base = {
        p.name: p.typical if p.scale == "log" or not p.strength else p.null + FAINT * (p.typical - p.null)
        for p in effect.parameters
    }
    search = SEARCHES.get(effect.id)
    if search is None:
        return [base]
    try:
        return search(effect, base, residuals)
    except EffectError:
        return [base]


def _sides(_: Effect, base: Start, residuals: SweepResiduals) -> list[Start]:
    """Alike on all axes, or more at B or in y: as the largest change is stated, these are separate local minima."""
    sides = product(*((0.0, -0.5) for name in imbalance.NAMES[: residuals.rig.n_planes]))
    return [{**base, **dict(zip(imbalance.NAMES, side, strict=False))} for side in sides]


def _lags(_: Effect, base: Start, __: SweepResiduals) -> list[Start]:
    """Eddy currents as typical, and ones whose lag is of first order up to a corner near the end of the band."""
    return [base, {**base, "time_constant_s": 1e-5, "corner_rad_s": 2e4}]


def _laws_of_flux(effect: Effect, base: Start, _: SweepResiduals) -> list[Start]:
    """Saturation by the current, and by several shares of the flux."""
    saturation = next(p for p in effect.parameters if p.name == "saturation_inverse_per_a")
    by_flux = {"saturation_inverse_per_a": saturation.low, "flux_power": 5.0}
    return [{**base, "flux_share": 0.0}, *({**base, **by_flux, "flux_share": share} for share in (0.35, 0.5, 0.7))]


def _loops(_: Effect, base: Start, residuals: SweepResiduals) -> list[Start]:
    """Hysteresis with plays of every width, and with plays about widths that the measured currents pass through."""
    o = residuals.o
    swing = float(np.quantile(np.abs(o.U if o.I is None else o.I)[:, o.fundamental].max(axis=1), 0.9))
    widths = (0.25 * swing, 0.6 * swing)
    return [base, *({**base, "narrowest_a": 0.5 * m, "widest_inverse_per_a": 1 / (1.5 * m)} for m in widths)]


def _both_signs(_: Effect, base: Start, __: SweepResiduals) -> list[Start]:
    return [{name: sign * v for name, v in base.items()} for sign in (1.0, -1.0)]


SEARCHES: Mapping[str, Search] = {
    "amplifier_bandwidth": _sides,
    "amplifier_voltage_limit": slews.starts,
    "eddy_currents": _lags,
    "extra_flexible_mode": resonances.starts,
    "magnetic_hysteresis": _loops,
    "magnetic_saturation": _laws_of_flux,
    "off_centre_rotor": _both_signs,
    "support_resonance": resonances.starts,
    "thermal_drift": drifts.starts,
    "touchdown_contact": stops.starts,
}
"""By effect, the function that finds its starts; other effects start at a `FAINT` strength."""
