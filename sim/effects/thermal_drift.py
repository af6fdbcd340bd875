"""Magnets whose factors drift while they warm up."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.effect import Effect, Parameter
from sim.rig import Drift, Rig


def _apply(rig: Rig, p: Mapping[str, float]) -> Rig:
    ki, ks, duration = p["ki_change"], p["ks_change"], p["duration_s"]
    if rig.drift is not None:
        ki += rig.drift.ki_change * duration / rig.drift.duration_s
        ks += rig.drift.ks_change * duration / rig.drift.duration_s
    return replace(rig, drift=Drift(ki, ks, duration, p["curvature"]) if ki or ks else None)


def _restated(values: Mapping[str, float], like: Mapping[str, float]) -> Mapping[str, float]:
    """The same drift, stated over another time: what has changed when that time has passed."""
    longer = like["duration_s"] / values["duration_s"]
    drift = Drift(values["ki_change"], values["ks_change"], values["duration_s"], values["curvature"])
    share = float(drift.progress(np.array(longer)))
    return {
        "ki_change": values["ki_change"] * share,
        "ks_change": values["ks_change"] * share,
        "duration_s": like["duration_s"],
        "curvature": values["curvature"] * longer,
    }


EFFECT = Effect(
    id="thermal_drift",
    path="plant",
    parameters=(
        Parameter("ki_change", "1", -0.3, 0.3, -0.05, 0.0, description="relative change of ki after duration_s"),
        Parameter("ks_change", "1", -0.4, 0.4, -0.03, 0.0, description="relative change of ks after duration_s"),
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
    ),
    apply=_apply,
    restated=_restated,
    law="ki (1 + dki g), ks (1 + dks g), g = (1 - exp(-c t/T)) / (1 - exp(-c)), t/T for c = 0",
    signature="error of y/i grows with the time of the point, not with its frequency or amplitude",
    aliases=("off_centre_rotor",),
    separated_by="the first points repeated last",
    source="Schweitzer and Maslen (eds.), Magnetic Bearings, Springer 2009, chapter 4 (ki, ks and the gap)",
)
