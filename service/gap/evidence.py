"""Evidence of fitted twins, and probabilities from it.

Laplace's approximation weighs fit, tolerances and freedom (MacKay, Information Theory, 2003, chapter 28). What a
fit leaves beyond the noise is judged as an error of unknown size with a limited number of independent values,
which gives a Student-t likelihood: two laws of the same effect differ by far more than noise, so the ratio of
what they leave tells them apart, not the difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.fit import Fit, Problem

Real = NDArray[np.float64]

MODEL_ERRORS = 40.0
"""Independent values in what a twin leaves: residuals of neighbouring lines and channels go together."""


def occam(problem: Problem, fit: Fit) -> float:
    """Log of the share of the prior that the data leave: -1/2 logdet of curvature, effect priors uniform."""
    k = len(problem.nuisance)
    width = problem.high - problem.low
    # A parameter that the data say nothing of keeps its prior, a uniform one of that width.
    prior = np.concatenate([np.ones(k), 12.0 / np.maximum(width, 1e-12) ** 2])
    hessian = fit.curvature + np.diag(prior)
    _, logdet = np.linalg.slogdet(hessian)
    return float(-0.5 * logdet + 0.5 * np.sum(np.log(prior)))


def log_evidence(chi_square: float, penalty: float, occam_factor: float, noise_chi_square: float) -> float:
    """Log evidence of a fit; ``noise_chi_square`` is what a right twin leaves.

    Below it residuals are noise and count as such; what lies above is the twin's own error.
    """
    excess = max(chi_square - noise_chi_square, 0.0)
    gained = max(noise_chi_square - chi_square, 0.0)
    return float(-0.5 * MODEL_ERRORS * np.log1p(excess / MODEL_ERRORS) + 0.5 * gained - 0.5 * penalty + occam_factor)


def probabilities(log_evidence: Real) -> Real:
    """Normalised probabilities of alternatives with equal prior odds.

    >>> probabilities(np.array([0.0, 0.0])).tolist()
    [0.5, 0.5]
    """
    weight = np.exp(log_evidence - np.max(log_evidence))
    return np.asarray(weight / weight.sum())
