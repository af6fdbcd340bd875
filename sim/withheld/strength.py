"""How strong a withheld effect is: from barely to plainly visible, within what the catalogue allows."""

from __future__ import annotations

import numpy as np

from sim import imbalance
from sim.datasheet import AXES
from sim.effect import Effect, Parameter
from sim.rig import Rig

Generator = np.random.Generator

WEAKEST, STRONGEST = 0.1, 1.6
"""Strengths as shares of the catalogue's typical, plainly visible ones."""
DISC = 0.4
"""Share of the gyroscopic moments that are of a disc where modes tilt it."""
FILTERED = 0.25
"""Share of the other controllers that have a notch of which the datasheet does not know."""
UNEVEN = 0.25
"""Share of the effects there may be one of in each axis that are on one bearing, plane or axis alone."""


def strength(effect: Effect, rig: Rig, g: Generator) -> dict[str, float]:
    """Values of an effect's parameters, from barely to plainly visible.

    Strengths are shares of the typical values, of either sign where the range allows it; of an effect with one
    parameter per axis, one or two axes have it; of one on all alike, some have it at one bearing, plane or axis alone.
    """
    effect, uneven = effect.of(rig), _uneven(effect, g)
    # the mean of all, where the one has a strength as drawn; of amplifiers the largest change is what is stated
    halved = 0 if effect.id == "amplifier_bandwidth" else np.count_nonzero(list(uneven.values()))
    alone = 0.5**halved
    share = float(WEAKEST * (STRONGEST / WEAKEST) ** g.uniform())
    special = _special(effect.id, share, g)
    per_axis = [p.name for p in effect.parameters if any(f"_{axis}" in p.name for axis in rig.axes)]
    on = set(g.choice(per_axis, int(g.integers(1, 3)), replace=False)) if len(per_axis) > 2 else set(per_axis)
    sign = float(g.choice([-1.0, 1.0]))
    values = {}
    for p in effect.parameters:
        if p.name in uneven:
            values[p.name] = uneven[p.name]
        elif p.name in special:
            values[p.name] = special[p.name]
        elif p.name in per_axis and p.name not in on:
            values[p.name] = p.null
        elif p.strength:
            signed = sign if p.low < 0 < p.high and -p.typical >= p.low else 1.0
            part = alone * share * float(g.uniform(0.6, 1.0))
            values[p.name] = _inside(p, p.null + signed * (p.typical - p.null) * part)
        else:
            values[p.name] = _inside(p, p.typical * 2.0 ** float(g.uniform(-1, 1)))
    if effect.id == "gyroscopic_coupling":
        values["polar_inertia_kgm2"] = abs(values["polar_inertia_kgm2"])  # a rotor that turns from x to y
    return values


def _uneven(effect: Effect, g: Generator) -> dict[str, float]:
    """Imbalances of an effect that has them: none, or one bearing's, plane's or axis's own."""
    names = [p.name for p in effect.parameters if p.name in imbalance.NAMES]
    if not names or g.uniform() > UNEVEN:
        return dict.fromkeys(names, 0.0)
    which = int(g.integers(1, 2 ** len(names)))  # the first, the second, or both
    return {name: float(g.choice([-1.0, 1.0])) if which >> k & 1 else 0.0 for k, name in enumerate(names)}


def _special(name: str, share: float, g: Generator) -> dict[str, float]:
    """Where a share of the typical value would make no sense: whole samples, mains, what the tones can reach."""
    if name == "logging_offset":
        return {"samples": float(g.choice([1.0, 2.0, -1.0]))}
    if name == "controller_mismatch":
        if g.uniform() > FILTERED:
            return {"filter_frequency_hz": 100.0, "filter_damping_ratio": 0.7}  # of no filter
        return {
            "derivative_change": 0.0,
            "lag_samples": 0.0,
            "filter_mid_change": -0.3 * share,
            "filter_frequency_hz": 30.0 * 25.0 ** float(g.uniform()),
            "filter_damping_ratio": float(g.uniform(0.1, 0.7)),
        }
    if name == "mains_interference":
        on_current = g.uniform() < 0.5
        hz = float(g.choice([50.0, 60.0]))
        return {"frequency_hz": hz, ("amplitude_m" if on_current else "amplitude_a"): 0.0}
    if name == "touchdown_contact":
        clearance, side = float(g.uniform(2e-6, 7e-6)), float(g.choice([0.0, 0.0, 1.0, -1.0]))
        return {"side": side, **{f"clearance_{axis}_m": clearance for axis in AXES}}
    if name == "support_resonance":
        pedestals, ratio = float(g.choice([0.0, 0.0, 1.0])), float(g.uniform(0.9, 1.1))
        softer = float(g.choice([1.0, 1.0, 1.0, g.uniform(0.7, 1.4)]))  # in one direction than in the other
        rocking = float(g.choice([0.0, 0.0, 0.0, g.uniform(1.0, 4.0)])) * (1.0 - pedestals)
        return {
            "frequency_hz": 15.0 * 50.0 ** float(g.uniform()),
            "pedestals": pedestals,
            "frequency_ratio": ratio,
            "plane_frequency_ratio": softer,
            "rocking": rocking,
            "rocking_frequency_ratio": float(g.uniform(1.2, 2.5)),
        }
    if name == "extra_flexible_mode":
        at_b = 0.06 * share * g.uniform(0.4, 1.0, 2) * g.choice([-1.0, 1.0], 2)
        at_s = at_b * g.uniform(0.7, 1.3, 2)
        return {
            "frequency_hz": 60.0 * 20.0 ** float(g.uniform()),
            "bearing_A_per_sqrt_kg": float(at_b[0]),
            "bearing_B_per_sqrt_kg": float(at_b[1]),
            "sensor_A_per_sqrt_kg": float(at_s[0]),
            "sensor_B_per_sqrt_kg": float(at_s[1]),
        }
    if name == "gyroscopic_coupling":
        of_disc = {f"mode{k}_slope_per_m_sqrt_kg": float(g.uniform(-1.0, 1.0)) for k in (1, 2)}
        tilted = of_disc if g.uniform() < DISC else dict.fromkeys(of_disc, 0.0)
        return {"mode_coupling": 0.02 * share * float(g.choice([-1.0, 0.0, 1.0])), **tilted}
    if name == "internal_damping":
        return {"mode_imbalance": float(g.choice([0.0, 0.0, 1.0, -1.0]))}
    if name == "cross_coupled_stiffness":  # one speed cannot tell what part goes with it
        return {"by_speed_ns_per_m": 0.0, "between": float(g.choice([0.0, 0.0, 1.0]))}
    if name == "eddy_currents":
        return {"corner_rad_s": float(g.choice([1.0, 10.0, 300.0]))}
    return {}


def _inside(p: Parameter, value: float) -> float:
    low = p.low if p.scale == "log" else min(p.low, p.null)
    return float(np.clip(value, low, max(p.high, p.null)))
