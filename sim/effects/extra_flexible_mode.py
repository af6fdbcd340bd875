"""A flexible mode that the twin does not have."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import OF_PLANES, of_plane
from sim.rig import FlexibleMode, Rig
from sim.sizes import MASS

HIGHEST_DAMPING = 0.1
"""Damping ratio from which a resonance is no mode of a steel rotor."""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    at_bearings = (p["bearing_A_per_sqrt_kg"], p["bearing_B_per_sqrt_kg"])
    if at_bearings == (0.0, 0.0):
        return rig  # the magnets do not excite it
    at_sensors = (p["sensor_A_per_sqrt_kg"], p["sensor_B_per_sqrt_kg"])
    more, own = p["plane_imbalance"], 2 * math.pi * p["frequency_hz"]
    shares = (1 + more, 1 - more) if rig.n_planes == 2 else (1.0,)
    planes = []
    for k, (modes, share) in enumerate(zip(rig.rotor.modes, shares, strict=True)):
        frequency = own * p["plane_frequency_ratio"] ** k
        shape = (share * at_bearings[0], share * at_bearings[1])
        planes.append((*modes, FlexibleMode(frequency, p["damping_ratio"], shape, at_sensors)))
    return replace(rig, rotor=replace(rig.rotor, modes=tuple(planes)))


def _restated(values: Mapping[str, float], like: Mapping[str, float]) -> Mapping[str, float]:
    """The same mode, with the sign of its shape, which is arbitrary, chosen as in ``like``."""
    shape = [name for name in values if name.endswith("_per_sqrt_kg")]
    if sum(values[name] * like[name] for name in shape) >= 0:
        return values
    return {**values, **{name: -values[name] for name in shape}}


def _like_a_support(values: Mapping[str, float]) -> Sequence[Mapping[str, float]]:
    """The mode that imitates a resonant support: a housing of mass m moves bearings and sensors alike, by 1/sqrt(m)."""
    shape = math.sqrt(values["inverse_mass_per_kg"])
    alike = {
        "frequency_hz": values["frequency_hz"],
        "damping_ratio": min(values["damping_ratio"], HIGHEST_DAMPING),
        **{f"{place}_per_sqrt_kg": shape for place in ("bearing_A", "bearing_B", "sensor_A", "sensor_B")},
        **{name: values[name] for name in OF_PLANES if name in values},
    }
    return [alike]


EFFECT = Effect(
    id="extra_flexible_mode",
    path="plant",
    parameters=(
        Parameter("frequency_hz", "Hz", 5.0, 3000.0, 700.0, 700.0, "log", "natural frequency", strength=False),
        Parameter("damping_ratio", "1", 1e-4, HIGHEST_DAMPING, 2e-3, 2e-3, "log", strength=False),
        Parameter(
            "bearing_A_per_sqrt_kg",
            "1/sqrt(kg)",
            -0.3,
            0.3,
            0.03,
            0.0,
            description="shape, unit modal mass",
            goes_with=MASS**-0.5,
        ),
        Parameter(
            "bearing_B_per_sqrt_kg",
            "1/sqrt(kg)",
            -0.3,
            0.3,
            -0.02,
            0.0,
            description="shape, unit modal mass",
            goes_with=MASS**-0.5,
        ),
        Parameter(
            "sensor_A_per_sqrt_kg",
            "1/sqrt(kg)",
            -0.3,
            0.3,
            0.03,
            0.03,
            description="shape, unit modal mass",
            goes_with=MASS**-0.5,
            strength=False,
        ),
        Parameter(
            "sensor_B_per_sqrt_kg",
            "1/sqrt(kg)",
            -0.3,
            0.3,
            -0.03,
            -0.03,
            description="shape, unit modal mass",
            goes_with=MASS**-0.5,
            strength=False,
        ),
        of_plane("the mode", dormant=True),
        rarely_needed(
            "plane_frequency_ratio",
            "1",
            0.8,
            1.25,
            1.0,
            "log",
            "frequency in y over that in x, which frequency_hz is; not used on one plane",
            wakes=(0.99, 1.01),
        ),
    ),
    apply=_apply,
    restated=_restated,
    likened={"support_resonance": _like_a_support},
    law="+ phi_s phi_b^T/(s^2 + 2 z w s + w^2) in the receptance of each plane, times 1 + p in x and "
    "1 - p in y, of frequency w in x and q w in y: a structure beside the rotor may swing in one direction, or softer",
    signature="one more peak of y/i with a residue of rank one, which may be negative where sensor and bearing differ",
    aliases=("support_resonance",),
    separated_by="signs of the residues (a support's are all of one kind); speed splits a rotor mode only",
    source="Ewins, Modal Testing, 2nd ed., Research Studies Press 2000, chapter 2",
)
