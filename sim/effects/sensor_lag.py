"""Sensors slower than the datasheet says: a first-order pole, a dead time."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.imbalance import parameters, shares
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    of_axes, sensors = shares(rig, p), rig.sensors
    lag_s, delay_s = sensors.lag_s + p["time_constant_s"] * of_axes, sensors.delay_s + p["delay_s"] * of_axes
    sensors = replace(sensors, lag_s=lag_s, delay_s=delay_s)
    return replace(rig, sensors=sensors)


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
        *parameters("sensors", dormant=True),
    ),
    apply=_apply,
    law="y = x exp(-s tau)/(1 + s T)",
    signature="y/i lags in proportion to frequency, gain nearly flat, the same at any amplitude",
    aliases=("loop_delay", "eddy_currents"),
    separated_by="logged i (a delay before it); frequencies above half the pole's (pole or delay of the sensor); "
    "a wide band (eddy currents go with the root of frequency)",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 3 (sensors)",
)
