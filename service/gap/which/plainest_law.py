"""The simplest law of an explanation that the data do not contradict.

A pole and a delay of a sensor, laminated and solid iron, two laws of saturation: such parameters are nearly aliases, so
a fit of both ends anywhere along a valley, and neither value means anything. One of them alone fits as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.distributions import chi2_above
from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.weighing.ranking import LOG_EVIDENCE_PER_EFFECT, Ranked, ranked, renormalised
from service.gap.which.refits import cost
from sim.effects import CATALOGUE

WORTH_BY_CHANCE = 1 / 70
"""Probability with which optional parameters that are null explain as much chi-square by chance, all together, below
which they are kept: from 6 on for one, from 14 on for five, in units of the residual variance. Evidence is not used, as
it depends on how wide a parameter's range is."""
LOG_EVIDENCE_PER_CHOICE = float(np.log(2))
"""Log evidence that each parameter left out costs: the prior odds that a law has it are even."""

NEARLY = 15.0
"""Lead in log evidence beyond which an effect beats the plain twin whatever its optional parameters cost."""


def weighed_plainly(fitter: Fitter, ground: Ground, order: Sequence[Ranked]) -> list[Ranked]:
    """Explanations by falling evidence, with those of simpler laws where optional parameters cost the lead.

    Of four amplifiers slow by three tolerances each, the plain twin may move each so far; their law also has lags,
    dampings and imbalances, which the data find to be zero at the price of an Occam factor each. Only where the plain
    twin is the best explanation or nearly so, and for explanations that leave clearly less.
    """
    null = next(r for r in order if not r.candidate.effects)
    if order[0].log_evidence - null.log_evidence > NEARLY:
        return list(order)
    least, others = 2 * LOG_EVIDENCE_PER_EFFECT, [r for r in order if r is not null]
    doubted = [r for r in others if cost(null.candidate) - cost(r.candidate) > least * len(r.candidate.effects)]
    found, price = [r.candidate for r in others], {}
    for r in doubted:
        plain = plainer_law(fitter, ground, r.candidate)
        if plain is not r.candidate:
            found.append(plain)
            price[id(plain)] = LOG_EVIDENCE_PER_CHOICE * (len(_used(r.candidate)) - len(_used(plain)))
    if not price:
        return list(order)
    again = ranked(null.candidate, found)
    priced = [replace(r, log_evidence=r.log_evidence - price.get(id(r.candidate), 0.0)) for r in again]
    likeliest: dict[tuple[str, ...], Ranked] = {}
    for r in sorted(priced, key=lambda r: -r.log_evidence):
        likeliest.setdefault(r.candidate.effects, r)
    return renormalised(list(likeliest.values()))


def plainer_law(fitter: Fitter, ground: Ground, best: Candidate) -> Candidate:
    """The explanation fitted without optional parameters, as many of them as cost little chi-square.

    Without all of them; or else without all that can be left out one by one; or else without one. Standard deviations
    stay those of the full law, as nothing says that the parameters left out are exactly null.
    """
    used = _used(best)
    per_residual = max(1.0, best.fit.chi_square / best.fit.n_residuals)
    plain: dict[frozenset[tuple[str, str]], Candidate] = {}  # by the parameters left out

    def fit(without: Sequence[frozenset[tuple[str, str]]]) -> None:
        tasks = [Task(ground, best.effects, (best.fit.values,), best.fit.theta, (EXACT,), nulled=w) for w in without]
        for task, c in zip(tasks, fitter.each(tasks), strict=True):
            if c is not None:
                plain[task.nulled] = replace(c, standard_deviations=best.standard_deviations)

    def as_good() -> dict[frozenset[tuple[str, str]], Candidate]:
        """Those of the fits that are about as good as the best."""
        # along a valley the fit of the full law may have ended above its optimum, which a plainer one is nearer to
        least = min([best.fit.cost, *(c.fit.cost for c in plain.values())])
        return {
            left_out: c
            for left_out, c in plain.items()
            if c.fit.cost - least < per_residual * chi2_above(WORTH_BY_CHANCE, len(left_out))
        }

    everything, one_by_one = frozenset(used), [frozenset([one]) for one in used]
    fit([*one_by_one, everything] if len(used) > 1 else one_by_one)
    good = as_good()
    several = frozenset().union(*(one for one in one_by_one if one in good))
    if everything not in good and len(several) > 1 and several != everything:
        fit([several])
        good = as_good()
    return max(good.items(), key=lambda one: (len(one[0]), -one[1].fit.cost))[1] if good else best


def _used(c: Candidate) -> list[tuple[str, str]]:
    """(effect, parameter) of an explanation that are optional and not at their null."""
    return [
        (name, p.name)
        for name, values in zip(c.effects, c.fit.values, strict=True)
        for p in CATALOGUE[name].parameters
        if p.optional and values[p.name] != p.null
    ]
