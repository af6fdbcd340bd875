"""Values of the datasheet that are farther off than its tolerances make plausible, renamed as effects.

A twin, plain or with effects, may move a sensor's gain by 3.5 of its tolerances; but by a stated tolerance such an
error is rarer than a faulty sensor is. The values concerned are parameters of effects of the catalogue, too, and are
fitted as such.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.weighing.ranking import Ranked, beyond_chance, noise_levels, ranked, renormalised
from service.gap.which.mixtures import STRAINED
from sim.effects import CATALOGUE

Real = NDArray[np.float64]

BELIEVED = 3.35
"""Tolerances from which a value is more likely an effect: among eight values, a normal error gets there in 0.6 % of the
rigs. If one in 25 rigs has such an effect, uniform over a tenth of the value, that is as likely there."""
ONE_MORE = 4.0
"""Chi-square that every further value of the same effect must explain."""
OFF_TOLERANCES = 1.0
"""Tolerances from which a value may belong to the effect. It is low, as only the ratio of the two sensor gains of a
plane is observed (a common gain is an alias of the magnets'): the plain twin moves each by half of the error."""
ERRORS_OF_STATED_VALUES = ("sensor_gain", "sensor_position", "rotor_inertia")
"""Effects that are errors of values that a datasheet states, each within a tolerance."""
SET_THE_SCALE = frozenset({"magnetic_saturation", "magnetic_hysteresis", "touchdown_contact"})
"""Nonlinear effects beside which no such error is named. The current or displacement at which their law bends gives the
scale of masses and gains, which are aliases of the magnets' stiffnesses else: an error of the law would be theirs."""


def beyond_tolerance(fitter: Fitter, ground: Ground, order: Sequence[Ranked], most: int) -> list[Ranked]:
    """The order with effects added that explain better as such than as errors of the datasheet, by falling evidence.

    Beside the best explanation's own effects, up to ``most`` in all, and where the datasheet states its tolerances.
    """
    order = list(order)
    while ground.nuisance.stated and len(order[0].candidate.effects) < most:
        best = order[0]
        fitted = (_as_effect(fitter, ground, order, name) for name in _possible(ground, best.candidate.effects))
        found = [r for r in fitted if r is not None and r.log_evidence > best.log_evidence]
        if not found:
            break
        named = {r.candidate.effects for r in found}
        rest = [r for r in order if r.candidate.effects not in named]
        order = renormalised(sorted([*found, *rest], key=lambda r: -r.log_evidence))
    return order


def _possible(ground: Ground, beside: Sequence[str]) -> list[str]:
    """Errors of stated values that can be named beside some effects."""
    if not SET_THE_SCALE.isdisjoint(beside):
        return []
    return [name for name in ERRORS_OF_STATED_VALUES if name in ground.part.effects and name not in beside]


def _as_effect(fitter: Fitter, ground: Ground, order: Sequence[Ranked], name: str) -> Ranked | None:
    """Values of the datasheet as an effect beside those of the best explanation; None where too little is off.

    Each value that is off is fitted alone, and all of them together. The evidence is that of the cheapest of these
    fits; the parameters are those of the last: of two sensors either may be at fault.
    """
    best, null = order[0].candidate, next(r.candidate for r in order if not r.candidate.effects)
    places, theta = _places(name, ground), best.fit.theta
    off = {p: float(ground.nuisance.off(theta)[at]) for p, at in places.items()}
    far = [p for p in places if abs(off[p]) > OFF_TOLERANCES]
    if sum(off[p] ** 2 for p in far) < BELIEVED**2 or (best.effects and others_strained(best, far, off)):
        return None
    changes = {p: off[p] * float(ground.nuisance.sigma[at]) for p, at in places.items()}
    choices = [[p] for p in far] + ([far] if len(far) > 1 else [])
    fits = fitter.each([_task(name, ground, best, changes, freed) for freed in choices])
    costs = [c.fit.cost + ONE_MORE * (len(freed) - 1) for c, freed in zip(fits, choices, strict=True) if c is not None]
    if fits[-1] is None:
        return None
    noise = noise_levels(null, [r.candidate for r in order])
    # what an effect's law leaves in the data its error may have drawn into the datasheet's values, too
    law_error = beyond_chance(best, noise) if best.effects else 0.0
    gained = best.fit.cost - min(costs) - BELIEVED**2 - law_error
    (r,) = (r for r in ranked(null, [*(r.candidate for r in order), fits[-1]]) if r.candidate is fits[-1])
    *others, sds = fits[-1].standard_deviations
    # a value that is not freed is as uncertain as its tolerance
    deviations = {p: sds[p] if p in far or p not in places else float(ground.nuisance.sigma[places[p]]) for p in sds}
    return replace(
        r,
        candidate=replace(fits[-1], standard_deviations=(*others, deviations)),
        log_evidence=order[0].log_evidence + gained / 2,
    )


def others_strained(best: Candidate, far: Sequence[str], off: Mapping[str, float]) -> bool:
    """Whether the datasheet's other values are off by more than chance, too: then the error is one of an effect's law.

    Such an error draws values of all kinds off.
    """
    others = len(best.fit.active) - len(far)
    left = best.fit.penalty - sum(off[p] ** 2 for p in far)
    return bool(left > others + STRAINED * np.sqrt(2 * others))


def _task(name: str, ground: Ground, best: Candidate, changes: Mapping[str, float], freed: Sequence[str]) -> Task:
    """Task to fit the parameters ``freed`` of an effect beside ``best``, from its changes and from twice these."""
    parameters, moved = [p.name for p in CATALOGUE[name].parameters], best.fit.theta.copy()
    moved[list(_places(name, ground).values())] = 0.0
    starts = [
        (*best.fit.values, {p: _stated(p, share * changes[p]) if p in freed else 0.0 for p in parameters})
        for share in (1, 2)
    ]
    held = frozenset((name, p) for p in parameters if p not in freed)
    return Task(ground, (*best.effects, name), tuple(starts), moved, (EXACT,), nulled=held)


def _places(name: str, ground: Ground) -> dict[str, int]:
    """By parameter of an effect, the index of the nuisance value that it changes."""
    names = ground.nuisance.names
    values = {p.name: value for p in CATALOGUE[name].parameters if (value := _value(p.name)) is not None}
    return {parameter: names.index(value) for parameter, value in values.items() if value in names}


def _stated(parameter: str, change: float) -> float:
    """A change of a nuisance value, logarithmic or in m, in the unit of the effect's parameter."""
    return change if parameter.endswith("_m") else float(np.expm1(change))


def _value(parameter: str) -> str | None:
    """Name of the nuisance value that a parameter changes; None of one that shapes the change.

    >>> [_value(name) for name in ("gain_change_xA", "shift_B_m", "mass_change", "inertia_change")]
    ['sensor_gain_xA', 'sensor_position_B', 'mass', 'transverse_inertia']
    """
    known = {"mass_change": "mass", "inertia_change": "transverse_inertia"}
    for before, after in (("gain_change_", "sensor_gain_"), ("shift_", "sensor_position_")):
        if parameter.startswith(before):
            return after + parameter.removeprefix(before).removesuffix("_m")
    return known.get(parameter)
