"""Housing or foundation that moves under the magnets' reaction."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from sim.effect import Effect, Parameter, rarely_needed
from sim.errors import EffectError
from sim.imbalance import NAMES, OF_PLANES, parameters, shares
from sim.rig import Rig, Support
from sim.sizes import MASS

ROCKING, ROCKING_FREQUENCY_RATIO, OF_A_SLAB = (0.0, 10.0), (0.1, 10.0), 3.0
"""A slab as long as from bearing to bearing has an inertia of a third of its mass there: rocking 3."""
HIGHEST_DAMPING = 0.3
ROCKING_DAMPING_QUOTIENT, ROCKING_PLANE_QUOTIENT = (0.1, 10.0), (0.5, 2.0)

SOFTER_PLANE = "plane_frequency_ratio"
HIDDEN_RATIOS, HIDDEN_DAMPING = (0.5, 0.7, 1.4, 2.0), 1.5
"""Frequencies of rocking over those of a translation that does not show, and how much more that may be damped."""
LEANS, AT_ONE_END = 0.05, 0.98
"""Imbalance of both ends from which a mode is likened to a housing that leans, and from which it moves one end alone,
whichever way the tenth of it goes that is left at the other."""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    if p["inverse_mass_per_kg"] < 1e-12:
        return rig
    if rig.support is not None:
        raise EffectError(f"rig {rig.name} already has a resonant support; change that one instead of adding another")
    w = 2 * math.pi * p["frequency_hz"]
    uneven = any(p[name] for name in NAMES)
    own = tuple(shares(rig, p).tolist()) if uneven else ()
    mass = 1 / p["inverse_mass_per_kg"]
    support = Support(
        mass,
        w,
        p["damping_ratio"],
        p["pedestals"],
        p["frequency_ratio"],
        p["damping_quotient"],
        p["plane_frequency_ratio"],
        p["rocking"],
        p["rocking_frequency_ratio"],
        p["rocking_damping_quotient"],
        p["rocking_plane_quotient"],
        p["rocking_imbalance"],
        own,
    )
    return replace(rig, support=support)


def _like_a_mode(values: Mapping[str, float]) -> Sequence[Mapping[str, float]]:
    """The supports that are most like a mode: a housing of the mean of its residues, which leans as the mode does.

    One that swings moves the ends against each other: of it no more than the mean is a housing's that translates. Or it
    is one that rocks, whose translation is somewhere else and does not show.
    """
    (at_a, sensed_a), (at_b, sensed_b) = (
        tuple(values[f"{place}_{end}_per_sqrt_kg"] for place in ("bearing", "sensor")) for end in "AB"
    )
    shape = {name: values[name] for name in ("frequency_hz", "damping_ratio")}
    shape |= {name: values[name] for name in OF_PLANES if name in values}
    both, more = at_a * sensed_a + at_b * sensed_b, at_a * sensed_a - at_b * sensed_b
    same_way = at_a * at_b >= 0 or abs(more) > AT_ONE_END * both
    if same_way and LEANS * both < abs(more) <= both / AT_ONE_END:
        return [{"inverse_mass_per_kg": both / 2, "end_imbalance": min(max(more / both, -1.0), 1.0), **shape}]
    translation = (at_a + at_b) * (sensed_a + sensed_b) / 4
    of_mean = [{"inverse_mass_per_kg": translation, **shape}] if translation > 0 else []
    residue = (at_a - at_b) * (sensed_a - sensed_b) / 4
    if residue <= 0:
        return of_mean
    slab = {
        **{parameter.name: parameter.null for parameter in EFFECT.parameters},
        **shape,
        "inverse_mass_per_kg": residue / OF_A_SLAB,
        "damping_ratio": min(HIDDEN_DAMPING * values["damping_ratio"], HIGHEST_DAMPING),
    }
    hidden = ({**slab, "frequency_hz": values["frequency_hz"] / ratio} for ratio in HIDDEN_RATIOS)
    return [*of_mean, *(rocks for own in hidden if (rocks := _that_rocks(own, values)))]


def _that_rocks(own: Mapping[str, float], mode: Mapping[str, float]) -> Mapping[str, float]:
    """A housing that rocks as a mode swings, which moves both ends against each other, bearings and sensors alike."""
    at_bearings, at_sensors = (
        0.5 * (mode[f"{place}_A_per_sqrt_kg"] - mode[f"{place}_B_per_sqrt_kg"]) for place in ("bearing", "sensor")
    )
    against = (mode[f"{place}_A_per_sqrt_kg"] * mode[f"{place}_B_per_sqrt_kg"] for place in ("bearing", "sensor"))
    rocking = at_bearings * at_sensors / own["inverse_mass_per_kg"]
    ratio = mode["frequency_hz"] / own["frequency_hz"]
    (_, most), (least, greatest) = ROCKING, ROCKING_FREQUENCY_RATIO
    if max(against) >= 0 or not 0 < rocking < most or not least < ratio < greatest:
        return {}
    alike = own.get(SOFTER_PLANE, 1.0), mode.get(SOFTER_PLANE, 1.0)
    return {
        **own,
        "pedestals": 0.0,
        "rocking": rocking,
        "rocking_frequency_ratio": ratio,
        "rocking_damping_quotient": _within(ROCKING_DAMPING_QUOTIENT, mode["damping_ratio"] / own["damping_ratio"]),
        "rocking_plane_quotient": _within(ROCKING_PLANE_QUOTIENT, alike[1] / alike[0]),
        "rocking_imbalance": 0.5 * (mode["bearing_A_per_sqrt_kg"] + mode["bearing_B_per_sqrt_kg"]) / at_bearings,
    }


def _within(limits: tuple[float, float], value: float) -> float:
    low, high = limits
    return min(max(value, low), high)


EFFECT = Effect(
    id="support_resonance",
    path="plant",
    parameters=(
        Parameter(
            "inverse_mass_per_kg",
            "1/kg",
            1e-6,
            2e-2,
            1 / 900,
            0.0,
            "log",
            "of the part that moves, mean of all",
            goes_with=MASS**-1,
        ),
        Parameter("frequency_hz", "Hz", 5.0, 1500.0, 430.0, 430.0, "log", "of the part on its spring", strength=False),
        Parameter("damping_ratio", "1", 1e-3, HIGHEST_DAMPING, 0.01, 0.01, "log", strength=False),
        Parameter(
            "pedestals",
            "1",
            0.0,
            1.0,
            0.0,
            0.0,
            description="share of it in a pedestal under each bearing, of which either moves alone",
            strength=False,
            optional=True,
        ),
        Parameter(
            "frequency_ratio",
            "1",
            0.7,
            1.4,
            1.0,
            1.0,
            "log",
            "of the pedestal at B over that at A",
            strength=False,
            optional=True,
        ),
        rarely_needed(
            "damping_quotient",
            "1",
            0.1,
            10.0,
            1.0,
            "log",
            "damping ratio of the pedestal at B over that at A",
            wakes=(1.3,),
        ),
        rarely_needed(
            "plane_frequency_ratio",
            "1",
            0.5,
            2.0,
            1.0,
            "log",
            "of the part in y over that in x, which frequency_hz is; not used on one plane",
            wakes=(0.9, 1.1),
        ),
        rarely_needed(
            "rocking",
            "1",
            *ROCKING,
            0.0,
            description="inverse inertia of a housing that rocks too, times the square of half the bearings' distance, "
            "over the inverse mass",
        ),
        rarely_needed(
            "rocking_frequency_ratio",
            "1",
            *ROCKING_FREQUENCY_RATIO,
            1.0,
            "log",
            "of its rocking over that of its translation",
        ),
        rarely_needed(
            "rocking_damping_quotient",
            "1",
            *ROCKING_DAMPING_QUOTIENT,
            1.0,
            "log",
            "damping ratio of its rocking over that of its translation",
        ),
        rarely_needed(
            "rocking_plane_quotient",
            "1",
            *ROCKING_PLANE_QUOTIENT,
            1.0,
            "log",
            "plane_frequency_ratio of its rocking over that of its translation",
        ),
        rarely_needed(
            "rocking_imbalance",
            "1",
            -1.0,
            1.0,
            0.0,
            description="0: it rocks about the middle between the bearings, 1: about bearing B, which it does not move",
        ),
        *parameters("supports", dormant=True),
    ),
    apply=_apply,
    law="mh xh'' + dh xh' + kh xh = -sum f, of both bearings or of either; bearings and sensors see the rotor relative "
    "to xh; where some move more, 1/mh goes as (1 +- e)(1 +- p), + at A, + in x; a housing of both has their mean and "
    "moves either end as their root, so that it leans; kh goes as the square of the plane's frequency; an angle of a "
    "housing that rocks likewise, about a point between the bearings and with a damping of its own",
    signature="a pair of pole and zero close together in y/i, in every channel with one sign; splits a peak nearby",
    aliases=("extra_flexible_mode",),
    likened={"extra_flexible_mode": _like_a_mode},
    includes={"extra_flexible_mode": _that_rocks},
    separated_by="signs of the residues; speed splits a rotor mode only; an accelerometer on the housing",
    source="Genta, Dynamics of Rotating Systems, Springer 2005, chapter 2 (rotor on compliant supports); "
    "Khader, System Identification of Active Magnetic Bearing for Commissioning, section 5.3.2 (the split first peak)",
)
