"""Values of the datasheet that are farther off than its tolerances let one believe.

A sensor's gain that is 3.5 of its tolerances off is explained by the plain twin, which may move it so far; but who
states a tolerance says that such an error is rarer than a wrong sensor is. Values of which that can be said are effects
of the catalogue, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.weighing.ranking import Ranked, ranked, renormalised
from sim.effects import CATALOGUE

Real = NDArray[np.float64]

BELIEVED = 3.35
"""Tolerances from which a value is more likely an effect: among eight values, a normal error gets there in 0.6 % of the
rigs. One in 25 rigs with an effect of that kind, spread evenly over a tenth of the value, is as likely there."""
ONE_MORE = 4.0
"""Chi-square that every further value of the same effect must be worth."""
OFF_TOLERANCES = 1.0
"""Tolerances from which a value may be one of the effect's. One sensor's gain is told against the other's in its plane
only, as a gain common to both is one of the magnets: each of them seems half as far off."""
ERRORS_OF_STATED_VALUES = ("sensor_gain", "sensor_position", "rotor_inertia")
"""Effects that are errors of values that a datasheet states, each within a tolerance."""


def beyond_tolerance(fitter: Fitter, ground: Ground, order: Sequence[Ranked]) -> list[Ranked]:
    """Explanations by falling evidence, with those values of the datasheet as effects that explain better so.

    Only where the plain twin is the best explanation, and where the datasheet states its tolerances.
    """
    null = order[0]
    if null.candidate.effects or not ground.nuisance.stated:
        return list(order)
    told = (_as_effect(fitter, ground, null, name) for name in ERRORS_OF_STATED_VALUES if name in ground.part.effects)
    found = [r for r in told if r is not None and r.log_evidence > null.log_evidence]
    named = {r.candidate.effects for r in found}
    rest = [r for r in order if r.candidate.effects not in named]
    return renormalised(sorted([*found, *rest], key=lambda r: -r.log_evidence)) if found else list(order)


def _as_effect(fitter: Fitter, ground: Ground, null: Ranked, name: str) -> Ranked | None:
    """Values of the datasheet as an effect; None where too little is off.

    Judged by the fewest of its values that do, told by all that may be: of two sensors either may be the one.
    """
    own, theta = _own(name, ground), null.candidate.fit.theta
    off = {p: float(ground.nuisance.off(theta)[at]) for p, at in own.items()}
    far = [p for p in own if abs(off[p]) > OFF_TOLERANCES]
    if sum(off[p] ** 2 for p in far) < BELIEVED**2:
        return None
    changes = {p: off[p] * float(ground.nuisance.sigma[at]) for p, at in own.items()}
    freed = [[p] for p in far] + ([far] if len(far) > 1 else [])
    fits = fitter.each([_task(name, ground, theta, changes, these) for these in freed])
    costs = [c.fit.cost + ONE_MORE * (len(these) - 1) for c, these in zip(fits, freed, strict=True) if c is not None]
    if fits[-1] is None:
        return None
    gained = null.candidate.fit.cost - min(costs) - BELIEVED**2
    (r,) = (r for r in ranked(null.candidate, [fits[-1]]) if r.candidate.effects)
    (sds,) = fits[-1].standard_deviations
    # what is not the effect's is as uncertain as its tolerance
    spread = {p: sds[p] if p in far or p not in own else float(ground.nuisance.sigma[own[p]]) for p in sds}
    return replace(
        r, candidate=replace(fits[-1], standard_deviations=(spread,)), log_evidence=null.log_evidence + gained / 2
    )


def _task(name: str, ground: Ground, theta: Real, changes: Mapping[str, float], freed: Sequence[str]) -> Task:
    """Task to fit some of an effect's values from what is off of them, the whole or shared with another sensor."""
    parameters, moved = [p.name for p in CATALOGUE[name].parameters], theta.copy()
    moved[list(_own(name, ground).values())] = 0.0
    starts = [({p: _stated(p, share * changes[p]) if p in freed else 0.0 for p in parameters},) for share in (1, 2)]
    held = frozenset((name, p) for p in parameters if p not in freed)
    return Task(ground, (name,), tuple(starts), moved, (EXACT,), nulled=held)


def _own(name: str, ground: Ground) -> dict[str, int]:
    """Parameters of an effect with the place of the datasheet's values that they change."""
    names = ground.nuisance.names
    return {p.name: names.index(_value(p.name)) for p in CATALOGUE[name].parameters if _value(p.name) in names}


def _stated(parameter: str, change: float) -> float:
    """A change of a datasheet's value, logarithmic or in m, as the effect states it."""
    return change if parameter.endswith("_m") else float(np.expm1(change))


def _value(parameter: str) -> str:
    """Name of the datasheet's value that a parameter changes.

    >>> [_value(name) for name in ("gain_change_xA", "shift_B_m", "mass_change", "inertia_change")]
    ['sensor_gain_xA', 'sensor_position_B', 'mass', 'transverse_inertia']
    """
    known = {"mass_change": "mass", "inertia_change": "transverse_inertia"}
    for before, after in (("gain_change_", "sensor_gain_"), ("shift_", "sensor_position_")):
        if parameter.startswith(before):
            return after + parameter.removeprefix(before).removesuffix("_m")
    return known[parameter]
