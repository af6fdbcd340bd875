"""Magnets whose factors drift while they warm up: alike, one bearing or plane more than another, or each by its own."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from sim.datasheet import AXES
from sim.effect import Effect, Parameter, has_axis, rarely_needed
from sim.imbalance import parameters, shares
from sim.rig import Drift, Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    of_axes, duration = shares(rig, p), p["duration_s"]
    ki, ks = (
        p[f"{factor}_change"] * of_axes + np.array([p[f"{factor}_change_{axis}"] for axis in rig.axes])
        for factor in ("ki", "ks")
    )
    if (known := rig.drift) is not None:  # more of the drift that the rig has, with its course in time
        whole = known.progress(np.array(duration / known.duration_s))
        return replace(
            rig, drift=replace(known, ki_change=known.ki_change + ki / whole, ks_change=known.ks_change + ks / whole)
        )
    return replace(rig, drift=Drift(ki, ks, duration, p["curvature"]) if np.any(ki) or np.any(ks) else None)


def _restated(values: Mapping[str, float], like: Mapping[str, float]) -> Mapping[str, float]:
    """The same drift, with its changes stated after the time ``duration_s`` of ``like``."""
    of_ki, of_ks = ([name for name in values if name.startswith(f"{factor}_change")] for factor in ("ki", "ks"))
    ki, ks = (np.array([values[name] for name in names]) for names in (of_ki, of_ks))
    again = Drift(ki, ks, values["duration_s"], values["curvature"]).over(like["duration_s"])
    return {
        **values,
        **dict(zip(of_ki, again.ki_change.tolist(), strict=True)),
        **dict(zip(of_ks, again.ks_change.tolist(), strict=True)),
        "duration_s": again.duration_s,
        "curvature": again.curvature,
    }


def _of_one_magnet(factor: str, axis: str) -> Parameter:
    return rarely_needed(
        f"{factor}_change_{axis}",
        "1",
        -0.2,
        0.2,
        0.0,
        description=f"what {factor} of the magnet in {axis} changes beside: each has its own gap and temperature",
        wakes=(0.005,),
        needs=partial(has_axis, axis),
    )


EFFECT = Effect(
    id="thermal_drift",
    path="plant",
    parameters=(
        Parameter(
            "ki_change", "1", -0.3, 0.3, -0.05, 0.0, description="change of ki after duration_s, mean of all axes"
        ),
        Parameter("ks_change", "1", -0.4, 0.4, -0.03, 0.0, description="the same of ks"),
        Parameter("duration_s", "s", 1.0, 36e3, 300.0, 300.0, "log", "time that the change takes", strength=False),
        Parameter(
            "curvature",
            "1",
            0.0,
            8.0,
            0.0,
            0.0,
            description="duration_s in time constants of an exponential approach; 0: in proportion to time",
            strength=False,
            optional=True,
        ),
        *parameters("magnets"),
        *(_of_one_magnet(factor, axis) for factor in ("ki", "ks") for axis in AXES),
    ),
    apply=_apply,
    restated=_restated,
    law="ki (1 + (dki a + di) g), ks (1 + (dks a + ds) g), g = (1 - exp(-c t/T)) / (1 - exp(-c)), t/T for c = 0; "
    "a = (1 +- e)(1 +- p), + at A, + in x; di, ds of each magnet alone",
    signature="error of y/i grows with the time of the point, not with its frequency or amplitude",
    aliases=("off_centre_rotor",),
    separated_by="the first points repeated last",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 4 (ki, ks and the gap)",
)
