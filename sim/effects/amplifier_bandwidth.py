"""Amplifiers slower or faster, better or worse damped than the datasheet says, all or some of them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Array, Rig

LEAST_TERM = 1e-4
"""Second-order term from which amplifiers of first order are of second, with a pole ten thousand times as fast."""

SLOWEST = 0.05
"""Least bandwidth over the datasheet's, of amplifiers that change the other way than those that change most."""


def _of_axes(rig: Rig, p: Mapping[str, float]) -> Array:
    """What each amplifier changes over the one that changes most, (n,): 1 at most, and no less than -1."""
    of_axes, opposite = shares(rig, p), p["opposite_share"]
    return np.asarray((1 + opposite) * of_axes / of_axes.max() - opposite)


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    amplifiers, of_axes = rig.amplifiers, _of_axes(rig, p)
    damping = amplifiers.damping_ratio
    # the s^2 term shrinks, or comes, and the term in s stays
    if damping is not None:
        apart = 1 / np.sqrt(1 - p["first_order_share"] * of_axes)
        damping = damping * (1 + p["damping_change"] * of_axes)
    elif p["second_order_term"]:
        apart = 1 / np.sqrt(np.maximum(p["second_order_term"] * of_axes, LEAST_TERM))
        damping = np.full(rig.n_axes, 0.5)  # of wa^2/(s^2 + wa s + wa^2)
    else:
        apart = np.ones(rig.n_axes)
    faster = np.maximum(1 + p["frequency_change"] * of_axes, SLOWEST)
    return replace(
        rig,
        amplifiers=replace(
            amplifiers,
            natural_frequency_rad_s=amplifiers.natural_frequency_rad_s * apart * faster,
            damping_ratio=None if damping is None else damping * apart,
            lag_s=amplifiers.lag_s + p["lag_s"],
        ),
    )


EFFECT = Effect(
    id="amplifier_bandwidth",
    path="amplifier",
    parameters=(
        Parameter("frequency_change", "1", -0.7, 2.5, -0.13, 0.0, description="relative change of wa, the largest"),
        Parameter(
            "damping_change",
            "1",
            -0.5,
            1.0,
            0.05,
            0.0,
            description="relative change of the damping ratio; nothing on a first-order amplifier",
            optional=True,
        ),
        Parameter(
            "lag_s", "s", 0.0, 2e-4, 2e-6, 0.0, description="time constant of a further first-order lag", optional=True
        ),
        rarely_needed(
            "first_order_share",
            "1",
            0.0,
            0.998,
            0.0,
            description="share of the s^2 term that is missing: at 1 the amplifiers are of first order, wa/(2 za)",
            wakes=(0.9,),
            needs=lambda rig: rig.amplifiers.damping_ratio is not None,
        ),
        rarely_needed(
            "second_order_term",
            "1",
            0.0,
            4.0,
            0.0,
            description="coefficient of s^2/wa^2 that amplifiers have which the datasheet states as of first order",
            wakes=(0.5,),
            needs=lambda rig: rig.amplifiers.damping_ratio is None,
        ),
        *parameters("amplifiers"),
        of_diagonal("amplifiers"),
        rarely_needed(
            "opposite_share",
            "1",
            0.0,
            1.0,
            0.0,
            description="change, over the largest and the other way, of an amplifier whose share is nil",
        ),
    ),
    apply=_apply,
    law="A(s) = 1/((1 - q) s^2/wa^2 + 2 za s/wa + 1) with wa (1 + f), za (1 + d), or 1/(r s^2/wa^2 + s/wa + 1), then "
    "1/(1 + s T); f a, d a, q a and r a where some change more, a in proportion to (1 +- e)(1 +- p), + at A, + in x, 1 "
    "at most; (1 + o) a - o where some change the other way",
    signature="i/u: gain falls and phase lags together towards high frequency, the same at any amplitude",
    aliases=("loop_delay", "eddy_currents", "amplifier_voltage_limit"),
    separated_by="logged i; gain of i/u (a delay leaves it flat); amplitude at one frequency (a voltage limit)",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 3 (power amplifiers)",
)
