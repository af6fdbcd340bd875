"""The simplest law of an explanation that the data do not contradict.

A pole and a delay of a sensor, laminated and solid iron, two laws of saturation: such parameters are nearly aliases, so
a fit of both ends anywhere along a valley, and neither value means anything. One of them alone fits as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from service.distributions import chi2_above
from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.weighing.ranking import LOG_EVIDENCE_PER_EFFECT, Ranked, ranked, renormalised
from service.gap.which.refits import cost
from sim.effects import CATALOGUE

LeftOut = frozenset[tuple[str, str]]
"""(effect, parameter) that are held at their null."""

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
    for r, plain in zip(doubted, plainer_laws(fitter, ground, [r.candidate for r in doubted]), strict=True):
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
    """As `plainer_laws` of one explanation."""
    return plainer_laws(fitter, ground, [best])[0]


def plainer_laws(fitter: Fitter, ground: Ground, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The explanations fitted without optional parameters, as many of them as cost little chi-square.

    Without all of them; or else without all that can be left out one by one; or else without one. Standard deviations
    stay those of the full law, as nothing says that the parameters left out are exactly null.
    """
    laws = [_Laws(c) for c in candidates]
    for without in (_Laws.at_first, _Laws.several):
        wanted = [(law, left_out) for law in laws for left_out in without(law)]
        tasks = [law.task(ground, left_out) for law, left_out in wanted]
        for (law, left_out), c in zip(wanted, fitter.each(tasks), strict=True):
            if c is not None:
                law.plainer[left_out] = replace(c, standard_deviations=law.full.standard_deviations)
    return [law.plainest() for law in laws]


@dataclass
class _Laws:
    """An explanation and what is fitted of it without some of its optional parameters."""

    full: Candidate
    plainer: dict[LeftOut, Candidate] = field(default_factory=dict)
    """by the parameters left out"""

    def at_first(self) -> list[LeftOut]:
        """What to leave out at first: each parameter, and all of them."""
        one_by_one = [frozenset([one]) for one in _used(self.full)]
        return [*one_by_one, frozenset().union(*one_by_one)] if len(one_by_one) > 1 else one_by_one

    def several(self) -> list[LeftOut]:
        """What to leave out then: all that cost little one by one, where all parameters together cost more."""
        used, good = frozenset(_used(self.full)), self._good()
        several = frozenset().union(*(left_out for left_out in good if len(left_out) == 1))
        return [several] if used not in good and len(several) > 1 and several != used else []

    def task(self, ground: Ground, left_out: LeftOut) -> Task:
        """The fit without some parameters."""
        fit = self.full.fit
        return Task(ground, self.full.effects, (fit.values,), fit.theta, (EXACT,), nulled=left_out)

    def plainest(self) -> Candidate:
        """The fit without most parameters that is about as good as the best; the full one where none is."""
        good = self._good()
        return max(good.items(), key=lambda one: (len(one[0]), -one[1].fit.cost))[1] if good else self.full

    def _good(self) -> dict[LeftOut, Candidate]:
        """Those of the fits that are about as good as the best."""
        # along a valley the fit of the full law may have ended above its optimum, which a plainer one is nearer to
        least = min([self.full.fit.cost, *(c.fit.cost for c in self.plainer.values())])
        per_residual = max(1.0, self.full.fit.chi_square / self.full.fit.n_residuals)
        return {
            left_out: c
            for left_out, c in self.plainer.items()
            if c.fit.cost - least < per_residual * chi2_above(WORTH_BY_CHANCE, len(left_out))
        }


def _used(c: Candidate) -> list[tuple[str, str]]:
    """(effect, parameter) of an explanation that are optional and not at their null."""
    return [
        (name, p.name)
        for name, values in zip(c.effects, c.fit.values, strict=True)
        for p in CATALOGUE[name].parameters
        if p.optional and values[p.name] != p.null
    ]
