"""Iron that saturates: less force per ampere at large current."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Rig
from sim.sizes import BIAS


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    magnets, of_axes = rig.magnets, shares(rig, p)
    if p["saturation_inverse_per_a"] > 1e-12:
        # Cubic terms i^3/(3 is^2) of saturations in series add.
        inverse = np.hypot(1 / magnets.saturation_current_a, p["saturation_inverse_per_a"] * of_axes)
        with np.errstate(divide="ignore"):  # an axis without saturation
            magnets = replace(magnets, saturation_current_a=1 / inverse)
    if p["flux_share"] > 0:
        n = magnets.flux_power if np.any(magnets.flux_share) else p["flux_power"]
        # the terms (B/Bs)^n of both add where they are small
        share = (magnets.flux_share**n + (p["flux_share"] * of_axes) ** n) ** (1 / n)
        magnets = replace(magnets, flux_share=share, flux_power=n)
    return replace(rig, magnets=magnets)


EFFECT = Effect(
    id="magnetic_saturation",
    path="plant",
    parameters=(
        Parameter(
            "saturation_inverse_per_a",
            "1/A",
            0.02,
            4.0,
            1 / 1.6,
            0.0,
            "log",
            "1/i_s of i_s tanh(i/i_s)",
            goes_with=BIAS**-1,
        ),
        Parameter(
            "flux_share",
            "1",
            0.0,
            1.2,
            0.3,
            0.0,
            description="B0/Bs, flux density at the bias over saturation's",
            optional=True,
        ),
        # from Froehlich's law B = H / (a + b H), which begins as n = 1 does, and an arc tangent's (1.6 at 2.2 times the
        # bias) to a knee: where the flux rose 0.4 times as fast beyond 1.3 of its bias, n of 29 came nearest
        Parameter(
            "flux_power", "1", 1.0, 40.0, 4.0, 4.0, description="n of a pole's pull / (1 + (B/Bs)^n)", strength=False
        ),
        *parameters("magnets", dormant=True),
        of_diagonal("magnets"),
    ),
    apply=_apply,
    law="the force sees i_s tanh(i/i_s), or each pole pulls 1/(1 + (B/Bs)^n) of what it should",
    signature="gain of y/i falls with amplitude, third harmonic in y, i clean",
    aliases=("amplifier_voltage_limit", "touchdown_contact", "magnetic_hysteresis"),
    separated_by="harmonics in i (voltage limit); phase of y/i, which saturation leaves alone (hysteresis); "
    "threshold in displacement rather than current (contact)",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 4 (saturation, load capacity)",
    nonlinear=True,
)
