"""A fitted drift, stated over the time that the experiment took."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.gap.compose import Composition
from service.gap.weighing.ranking import Ranked
from sim.effects import CATALOGUE
from sim.rig import Rig


def with_drift_rate(whole: Composition, datasheet: Rig, campaign_s: float | None) -> Composition:
    """The twins with a fitted drift stated over the time that the experiment took, s.

    A fit knows each point's share of the campaign only. Where the time is not known, or the datasheet has a drift
    already, the drift stays as it is.
    """
    if campaign_s is None or datasheet.drift is not None:
        return whole
    effect = CATALOGUE["thermal_drift"]
    duration = next(p for p in effect.parameters if p.name == "duration_s")
    stated_s = float(np.clip(campaign_s, duration.low, duration.high))

    def restated(r: Ranked) -> Ranked:
        c = r.candidate
        if "thermal_drift" not in c.effects:
            return r
        at = c.effects.index("thermal_drift")
        values, deviations = ([dict(v) for v in of] for of in (c.fit.values, c.standard_deviations))
        values[at]["duration_s"], deviations[at]["duration_s"] = campaign_s, 0.0
        if stated_s != campaign_s:  # a campaign of days, stated over the longest time that the parameter may have
            found, values[at] = values[at], dict(effect.restated(values[at], {**values[at], "duration_s": stated_s}))
            for name in ("ki_change", "ks_change"):
                deviations[at][name] *= values[at][name] / found[name] if found[name] else 1.0
        drift = None if c.fit.rig.drift is None else replace(c.fit.rig.drift, duration_s=campaign_s)
        fit = replace(c.fit, values=tuple(values), rig=replace(c.fit.rig, drift=drift))
        given = c.given | {("thermal_drift", "duration_s")}
        return replace(r, candidate=replace(c, fit=fit, standard_deviations=tuple(deviations), given=given))

    return Composition(tuple(restated(r) for r in whole.order))
