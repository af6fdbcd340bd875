"""Hysteresis of the iron: a loss angle that grows with amplitude and does not depend on frequency."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.rig import Rig

NARROWEST_A = 0.01
"""Half width below which one play counts as none: a Rayleigh loop then."""


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    m = rig.magnets
    at_reference = p["loss_angle_rad"] * m.hysteresis_reference_a / 0.5
    width = p["width_a"] if p["width_a"] >= NARROWEST_A else 0.0
    return replace(rig, magnets=replace(m, hysteresis_rad=m.hysteresis_rad + at_reference, hysteresis_width_a=width))


EFFECT = Effect(
    id="magnetic_hysteresis",
    path="plant",
    parameters=(
        Parameter(
            "loss_angle_rad",
            "rad",
            1e-4,
            0.15,
            0.02,
            0.0,
            "log",
            "lag of the force at 0.5 A of coil current, of one play the largest lag",
        ),
        Parameter(
            "width_a",
            "A",
            0.0,
            1.5,
            0.0,
            0.0,
            description="half width of one play; 0 for a Rayleigh loop, which is plays of every width",
            strength=False,
        ),
    ),
    apply=_apply,
    law="Rayleigh loop (1 + alpha A) i +- alpha/2 (A^2 - i^2), made of plays, or i + c play(i)",
    signature="lag and gain of y/i grow with the current's amplitude A, the same at any frequency; odd harmonics in y",
    aliases=("eddy_currents", "magnetic_saturation"),
    separated_by="a sweep of amplitude at low frequency: eddy currents do not depend on it, saturation has no lag",
    source="Lord Rayleigh, On the behaviour of iron and steel under the operation of feeble magnetic forces, "
    "Phil. Mag. 23, 1887, pp. 225-245",
    nonlinear=True,
)
