"""Sensors slower than the datasheet says: a first-order pole, a dead time."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter, rarely_needed
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    of_axes, sensors = shares(rig, p), rig.sensors
    moved = p["moved_share"] / sensors.bandwidth_rad_s
    with np.errstate(divide="ignore"):  # a pole that has moved as a whole leaves none
        left = np.where(moved > 0, 1 / (1 / sensors.bandwidth_rad_s - moved), sensors.bandwidth_rad_s)
    return replace(
        rig,
        sensors=replace(
            sensors,
            bandwidth_rad_s=left,
            lag_s=sensors.lag_s + p["time_constant_s"] * of_axes + moved,
            delay_s=sensors.delay_s + p["delay_s"] * of_axes,
        ),
    )


def _states_a_pole(rig: Rig) -> bool:
    return bool(np.isfinite(rig.sensors.bandwidth_rad_s).any())


EFFECT = Effect(
    id="sensor_lag",
    path="plant",
    parameters=(
        Parameter(
            "time_constant_s",
            "s",
            1e-7,
            1e-4,
            26.5e-6,
            0.0,
            "log",
            "1/(2 pi f) of a pole at f, in series with the datasheet's",
        ),
        Parameter(
            "delay_s", "s", 0.0, 1e-4, 1e-6, 0.0, description="dead time of the sensor's electronics", optional=True
        ),
        rarely_needed(
            "moved_share",
            "1",
            0.0,
            1.0,
            0.0,
            description="share of the datasheet's pole that has moved: at 1 that pole is slower, and no other is there",
            wakes=(0.9,),
            needs=_states_a_pole,
        ),
        *parameters("sensors", dormant=True),
        of_diagonal("sensors"),
    ),
    apply=_apply,
    law="y = x exp(-s tau)/((1 + s (1 - m) T0)(1 + s (T + m T0))), T0 = 1/(2 pi f0) of a pole f0 in the datasheet, "
    "0 without one",
    signature="y/i lags in proportion to frequency, gain nearly flat, the same at any amplitude",
    aliases=("loop_delay", "eddy_currents"),
    separated_by="logged i (a delay before it); frequencies above half the pole's (pole or delay of the sensor); "
    "a wide band (eddy currents go with the root of frequency)",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 3 (sensors)",
)
