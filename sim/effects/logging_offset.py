"""Control signal logged some samples off the current and the displacement."""

from collections.abc import Mapping
from dataclasses import replace

from sim.effect import Effect, Parameter
from sim.rig import Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    return replace(rig, logging_offset_samples=rig.logging_offset_samples + p["samples"])


EFFECT = Effect(
    id="logging_offset",
    path="controller",
    parameters=(
        Parameter(
            "samples",
            "samples",
            -3.0,
            3.0,
            1.0,
            0.0,
            description="logged u is so many samples early; any number in the linear model, whole ones in time",
        ),
    ),
    apply=_apply,
    law="u_log[k] = u[k + n]; r, i and y are logged right",
    signature="U - R + C Y has the phase n T w at unchanged gain; i/u has the same phase, yet the loop is as before",
    aliases=("loop_delay", "controller_mismatch"),
    separated_by="the controller residual U - R + C Y, nil with a real delay; the offset is a whole number of samples",
    source="Ljung, System Identification, 2nd ed., Prentice Hall 1999, chapter 14 (preprocessing of data)",
)
