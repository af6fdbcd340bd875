"""Rigs of the reference rig's kind, and what an engineer who is a little off knows of each."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from sim.datasheet import Datasheet, Mode, Tolerance
from sim.reference import reference_rig
from sim.rig import FlexibleMode, Noise, Rig

Generator = np.random.Generator

TOLERANCE = Tolerance(
    mode_frequency=0.005,
    amplifier_frequency=0.01,
    amplifier_damping=0.02,
    amplifier_gain=0.005,
)
NAME = "withheld"
"""Of every drawn rig, in its datasheet."""
DRAWN_SIGMAS = 0.7
"""Errors of the datasheet are drawn this many of its tolerances wide: engineers state them with some margin."""
SPEED_RAD_S = (60.0, 300.0)
AT_SPEED = 0.1
"""Share of the cases without an effect that needs it that are measured on a turning rotor."""


def base_rig(g: Generator) -> Rig:
    """The reference rig, or one of its kind: magnets, modes and amplifiers of its own, noise up to three times.

    Without gyroscopic moment at whichever speed: that is an effect.
    """
    rig = reference_rig()
    rig = replace(rig, rotor=replace(rig.rotor, polar_inertia_kgm2=0.0))
    loud = float(np.exp(g.uniform(0, math.log(3))))
    n = rig.noise
    rig = replace(
        rig, noise=Noise(n.displacement_m * loud, n.current_a * loud, n.displacement_step_m, n.current_step_a)
    )
    if g.uniform() < AT_SPEED:
        rig = replace(rig, speed_rad_s=float(g.uniform(*SPEED_RAD_S)))
    if g.uniform() < 0.6:
        return rig
    moved = g.uniform(0.97, 1.03, 2)

    def other(m: FlexibleMode, k: int) -> FlexibleMode:
        return replace(m, natural_frequency_rad_s=m.natural_frequency_rad_s * moved[k])

    modes = tuple(tuple(other(m, k) for k, m in enumerate(plane)) for plane in rig.rotor.modes)
    m, a = rig.magnets, rig.amplifiers
    return replace(
        rig,
        rotor=replace(rig.rotor, modes=modes),
        magnets=replace(m, ki=m.ki * g.uniform(0.93, 1.07, rig.n_axes), ks=m.ks * g.uniform(0.9, 1.1, rig.n_axes)),
        amplifiers=replace(a, natural_frequency_rad_s=a.natural_frequency_rad_s * g.uniform(0.98, 1.1)),
    )


def datasheet_of(rig: Rig, g: Generator, tolerance: Tolerance = TOLERANCE) -> Datasheet:
    """What an engineer knows of a rig: its values, each off by a draw within its tolerance."""

    def off(values: Any, sigma: float) -> tuple[float, ...]:
        v = np.atleast_1d(np.asarray(values, dtype=float))
        e = np.clip(g.standard_normal(v.shape), -2.5, 2.5)
        return tuple((v * (1 + DRAWN_SIGMAS * sigma * e)).tolist())

    r, t = rig.rotor, tolerance
    modes = []
    for same in zip(*r.modes, strict=True):  # the same mode in every plane
        mode = same[0]
        frequency = float(np.mean([m.natural_frequency_rad_s for m in same])) / (2 * math.pi)
        damping = float(np.mean([m.damping_ratio for m in same]))
        error = max(0.2, 1 + DRAWN_SIGMAS * t.mode_damping * float(np.clip(g.standard_normal(), -2, 2)))
        bearings, sensors = off(mode.shape_at_bearings, t.mode_shape), off(mode.shape_at_sensors, t.mode_shape)
        modes.append(
            Mode(
                off(frequency, t.mode_frequency)[0],
                damping * error,
                (bearings[0], bearings[1]),
                (sensors[0], sensors[1]),
            )
        )
    sensor = np.array(r.sensor_from_cog_m) + DRAWN_SIGMAS * t.sensor_position_m * g.standard_normal(2)
    zeta = rig.amplifiers.damping_ratio
    n = rig.n_axes
    return Datasheet(
        name=NAME,
        axes=rig.axes,
        mass_kg=off(r.mass_kg, t.mass)[0],
        transverse_inertia_kgm2=off(r.transverse_inertia_kgm2, t.transverse_inertia)[0],
        polar_inertia_kgm2=reference_rig().rotor.polar_inertia_kgm2,
        bearing_from_cog_m=r.bearing_from_cog_m,
        sensor_from_cog_m=(float(sensor[0]), float(sensor[1])),
        modes=tuple(modes),
        current_stiffness_n_per_a=off(rig.magnets.ki, t.current_stiffness),
        position_stiffness_n_per_m=off(rig.magnets.ks, t.position_stiffness),
        bias_current_a=tuple(rig.magnets.bias_current_a.tolist()),
        linear_range_m=rig.linear_range_m,
        amplifier_gain=(1.0,) * n,
        amplifier_natural_frequency_hz=off(
            rig.amplifiers.natural_frequency_rad_s / (2 * math.pi), t.amplifier_frequency
        ),
        amplifier_damping_ratio=None if zeta is None else off(zeta, t.amplifier_damping),
        sensor_gain=(1.0,) * n,
        sensor_bandwidth_hz=None,
        sample_time_s=rig.controller.sample_time_s,
        computing_delay_s=0.0,
        numerator=tuple(rig.controller.numerator.tolist()),
        denominator=tuple(rig.controller.denominator.tolist()),
        displacement_limit_m=rig.displacement_limit_m,
        current_limit_a=rig.current_limit_a,
        tolerance=t,
        tolerance_stated=True,
    )
