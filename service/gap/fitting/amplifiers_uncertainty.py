"""The posterior of the amplifiers' fit as a prior of the plant's, whose model from u to y contains them."""

from __future__ import annotations

import numpy as np

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.evidence import prior_precision
from service.gap.fitting.fit import Problem
from service.gap.fitting.part import Ground, Inherited
from service.gap.fitting.unknowns import slow_to_compute


def inherited_from(ground: Ground, candidate: Candidate) -> Inherited:
    """Normal posterior of a fitted part's values: the datasheet's and those of its effects.

    It is widened by the residuals beyond noise. Effects that are slow to compute stay as fitted.
    """
    unknowns, fit = Problem.of(ground, candidate.fit).unknowns, candidate.fit
    widened = max(1.0, fit.chi_square / fit.n_residuals)
    covariance = np.linalg.inv(fit.curvature / widened + prior_precision(unknowns))
    free = [k for k, name in enumerate(candidate.effects) if not slow_to_compute(name)]
    a = unknowns.n_nuisance
    at = [*range(a), *(a + j for j, (k, _) in enumerate(unknowns.parameters) if k in free)]
    return Inherited(
        candidate.effects,
        unknowns.active,
        tuple((candidate.effects[k], fit.values[k]) for k in free),
        unknowns.vector(fit)[at],
        np.linalg.inv(covariance[np.ix_(at, at)]),
    )
