"""Delay between the controller's output and the coil."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.imbalance import of_diagonal, parameters, shares
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    amplifiers = replace(rig.amplifiers, delay_s=rig.amplifiers.delay_s + p["delay_s"] * shares(rig, p))
    return replace(rig, amplifiers=amplifiers)


EFFECT = Effect(
    id="loop_delay",
    path="amplifier",
    parameters=(
        Parameter("delay_s", "s", 0.0, 3e-4, 35e-6, 0.0, description="delay, mean of all axes"),
        *parameters("amplifiers", dormant=True),
        of_diagonal("amplifiers"),
    ),
    apply=_apply,
    law="i(t) = A(s) u(t - tau)",
    signature="i/u: phase falls linearly with frequency, gain unchanged, the same at any amplitude",
    aliases=("amplifier_bandwidth", "logging_offset", "sensor_lag", "eddy_currents"),
    separated_by="logged i; gain of i/u against its phase; with an offset of the log only, U - R + C Y is not nil",
    source="Franklin, Powell and Workman, Digital Control of Dynamic Systems, 3rd ed., section 5.3",
)
