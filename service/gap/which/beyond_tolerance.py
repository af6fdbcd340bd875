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
from service.gap.fitting.part import STANDSTILL, Ground
from service.gap.fitting.stage import EXACT
from service.gap.weighing.another_rig import SET_THE_SCALE
from service.gap.weighing.ranking import Ranked, beyond_chance, noise_levels, ranked, renormalised
from service.gap.which.mixtures import STRAINED, with_aliases
from sim.effects import CATALOGUE

Real = NDArray[np.float64]

BELIEVED = 3.35
"""Tolerances from which a value is more likely an effect: among ten values, a normal error gets there in 0.8 % of the
rigs. If one in 25 rigs has such an effect, uniform over a tenth of the value, or a mode's damping over a factor of a
thousand, that is about as likely there. A mode's damping in both planes is one value."""
ONE_MORE = 4.0
"""Chi-square that every further value of the same effect must explain."""
OFF_TOLERANCES = 1.0
"""Tolerances from which a value may belong to the effect. It is low, as only the ratio of the two sensor gains of a
plane is observed (a common gain is an alias of the magnets'): the plain twin moves each by half of the error."""
ERRORS_OF_STATED_VALUES = ("sensor_gain", "sensor_position", "rotor_inertia", "modal_damping")
"""Effects that are errors of values that a datasheet states, each within a tolerance."""


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
        found += _with_aliases(fitter, ground, order, max(found, key=lambda r: r.log_evidence))
        named = {r.candidate.effects for r in found}
        rest = [r for r in order if r.candidate.effects not in named]
        order = renormalised(sorted([*found, *rest], key=lambda r: -r.log_evidence))
    return order


def _with_aliases(fitter: Fitter, ground: Ground, order: Sequence[Ranked], named: Ranked) -> list[Ranked]:
    """What ``named`` has with an alias in the place of one of its effects: beside a stated value's error that may fit.

    Alone the alias may have made up for that error by less likely values, and so have been the worse of the two.
    """
    candidates = [r.candidate for r in order]
    null = next(c for c in candidates if not c.effects)
    swapped = with_aliases(fitter, ground, named.candidate, candidates)
    weighed = {r.candidate: r for r in ranked(null, [*candidates, named.candidate, *swapped])}
    beyond = named.log_evidence - weighed[named.candidate].log_evidence  # by which a stated value's error is likelier
    return [replace(weighed[c], log_evidence=weighed[c].log_evidence + beyond) for c in swapped]


def _possible(ground: Ground, beside: Sequence[str]) -> list[str]:
    """Errors of stated values that can be named beside some effects.

    Not the damping of a rotor that turns: there the shaft's own damping is another effect, which has its own law.
    """
    if not SET_THE_SCALE.isdisjoint(beside):
        return []
    of_part = ground.part.effects
    possible = [name for name in ERRORS_OF_STATED_VALUES if name in of_part and name not in beside]
    return [name for name in possible if STANDSTILL.get(name) not in of_part]


def _as_effect(fitter: Fitter, ground: Ground, order: Sequence[Ranked], name: str) -> Ranked | None:
    """Values of the datasheet as an effect beside those of the best explanation; None where too little is off.

    Each value that is off is fitted alone, and all of them together. The evidence is that of the cheapest of these
    fits; the parameters are those of the last: of two sensors either may be at fault.
    """
    best, null = order[0].candidate, next(r.candidate for r in order if not r.candidate.effects)
    places, theta = _places(name, ground), best.fit.theta
    all_off, sigma = ground.nuisance.off(theta), ground.nuisance.sigma
    off = {p: float(all_off[at].mean()) for p, at in places.items()}
    far = [p for p in places if abs(off[p]) > OFF_TOLERANCES]
    price = ground.nuisance.surprise(theta, [k for p in far for k in places[p]])
    if price < BELIEVED**2 or (best.effects and others_strained(best, sum(len(places[p]) for p in far), price)):
        return None
    changes = {p: off[p] * float(sigma[at[0]]) for p, at in places.items()}
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
    deviations = {p: sds[p] if p in far or p not in places else float(sigma[places[p][0]]) for p in sds}
    return replace(
        r,
        candidate=replace(fits[-1], standard_deviations=(*others, deviations)),
        log_evidence=order[0].log_evidence + gained / 2,
    )


def others_strained(best: Candidate, far: int, price: float) -> bool:
    """Whether the datasheet's other values are off by more than chance, too: then the error is one of an effect's law.

    Such an error draws values of all kinds off. Of the penalty ``price`` is that of the ``far`` values.
    """
    others = len(best.fit.active) - far
    left = best.fit.penalty - price
    return bool(left > others + STRAINED * np.sqrt(2 * others))


def _task(name: str, ground: Ground, best: Candidate, changes: Mapping[str, float], freed: Sequence[str]) -> Task:
    """Task to fit the parameters ``freed`` of an effect beside ``best``, from its changes and from twice these."""
    parameters, moved = [p.name for p in CATALOGUE[name].parameters], best.fit.theta.copy()
    moved[[k for at in _places(name, ground).values() for k in at]] = 0.0
    starts = [
        (*best.fit.values, {p: _stated(p, share * changes[p]) if p in freed else 0.0 for p in parameters})
        for share in (1, 2)
    ]
    held = frozenset((name, p) for p in parameters if p not in freed)
    return Task(ground, (*best.effects, name), tuple(starts), moved, (EXACT,), nulled=held)


def _places(name: str, ground: Ground) -> dict[str, list[int]]:
    """By parameter of an effect, the indices of the nuisance values that it changes: of a mode one in each plane."""
    names = ground.nuisance.names
    values = {p.name: value for p in CATALOGUE[name].parameters if (value := _value(p.name)) is not None}
    found = {p: [names.index(n) for n in (value, *_of_planes(value)) if n in names] for p, value in values.items()}
    return {parameter: at for parameter, at in found.items() if at}


def _of_planes(value: str) -> list[str]:
    return [f"{value}_{plane}" for plane in "xy"]


def _stated(parameter: str, change: float) -> float:
    """A change of a nuisance value, logarithmic or in m, in the unit of the effect's parameter."""
    return change if parameter.endswith(("_m", "_log_ratio")) else float(np.expm1(change))


def _value(parameter: str) -> str | None:
    """Name of the nuisance value that a parameter changes, of a mode without its plane; None of one that shapes it.

    >>> [_value(name) for name in ("gain_change_xA", "shift_B_m", "mass_change", "inertia_change", "mode1_log_ratio")]
    ['sensor_gain_xA', 'sensor_position_B', 'mass', 'transverse_inertia', 'mode1_damping']
    """
    if parameter.endswith("_log_ratio"):
        return parameter.replace("_log_ratio", "_damping")
    known = {"mass_change": "mass", "inertia_change": "transverse_inertia"}
    for before, after in (("gain_change_", "sensor_gain_"), ("shift_", "sensor_position_")):
        if parameter.startswith(before):
            return after + parameter.removeprefix(before).removesuffix("_m")
    return known.get(parameter)
