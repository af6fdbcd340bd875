"""Laplace evidence of fitted twins, and probabilities from it.

Log evidence = log likelihood - penalty / 2 + log Occam factor (MacKay, Information Theory, 2003, chapter 28). Residuals
beyond noise are an error of the law, of unknown size and with a limited number of independent values, which gives a
Student-t likelihood: laws of the same effect differ by far more than noise, so the ratio of two chi-squares counts, not
their difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import Fit
from service.gap.fitting.unknowns import Unknowns
from sim.effect import Parameter

Real = NDArray[np.float64]

TEMPERATURE = 1.5
"""Log evidence is divided by this before it becomes a probability: the widths of priors are judgements, a rig's own law
of an effect differs from the catalogue's, and effects that hardly show are common. Calibrated on the blind trial, where
at 2 verdicts were underconfident; on rigs of an independent program, with other laws, they are somewhat overconfident.
`benchmarks/gap.py` prints the error of both."""
MODEL_ERRORS = 40.0
"""Effective number of independent values in a law's error: residuals of neighbouring lines and channels are
correlated."""

WEIGHTS = np.geomspace(1e-5, 0.5, 30)
"""Weights of chi-square beside the penalty among which the maximum of the likelihood is looked for."""


def prior_precision(unknowns: Unknowns) -> Real:
    """Prior precision of the unknowns, (a + e, a + e), with the variance of a uniform prior for effects' parameters."""
    k, own = unknowns.n_nuisance, unknowns.n_own
    width = (unknowns.high - unknowns.low)[:own]
    precision = unknowns.prior.copy()
    precision[range(k, k + own), range(k, k + own)] = 12.0 / np.maximum(width, 1e-12) ** 2
    return precision


def occam(unknowns: Unknowns, fit: Fit) -> float:
    """Log Occam factor, posterior over prior volume: 1/2 (logdet prior precision - logdet posterior precision).

    A shape parameter at the end of its range where the law is the simplest does not count.
    """
    used = np.ones(len(fit.curvature), dtype=bool)
    used[unknowns.n_nuisance :][: unknowns.n_own] = [not _at_simplest_end(p, fit.values[k]) for k, p in unknowns.own]
    prior, curvature = (m[np.ix_(used, used)] for m in (prior_precision(unknowns), fit.curvature))
    (_, after), (_, before) = np.linalg.slogdet(curvature + prior), np.linalg.slogdet(prior)
    return float(0.5 * (before - after))


def _at_simplest_end(p: Parameter, values: Mapping[str, float]) -> bool:
    """Whether a shape parameter is at its null, which is an end of its range."""
    return not p.strength and p.null in (p.low, p.high) and values[p.name] == p.null


def log_evidence(fit: Fit, occam_factor: float, noise: Sequence[float]) -> float:
    """Log evidence of a fit; ``noise`` is the chi-square that a right twin leaves in each of its groups.

    Groups (fundamental and harmonics of each sweep) are judged separately, so that a gap in one does not hide a gap in
    another. The fit minimised chi-square and penalty. Where much is left beyond noise, the likelihood is at its maximum
    elsewhere: with values nearer to the datasheet and, of the amplifiers, to what their own data say. Without that step
    back, an error of the plant's law that amplifiers' values took up would be charged by their data, at full weight.
    """
    excess = np.array([max(chi - level, 0.0) for (chi, _), level in zip(fit.groups, noise, strict=True)])
    best = float(log_likelihood(excess).sum() - 0.5 * fit.penalty)
    left = np.where(np.arange(len(excess)) % 2 == 0, excess, 0.0)  # fundamentals: values have little of the harmonics
    if fit.trade_off is not None and left.sum() > MODEL_ERRORS:
        for weight in WEIGHTS:
            rise, fall = fit.trade_off.at_weight(weight)
            beyond = log_likelihood(excess + rise * left / left.sum())
            # a price below the penalty, where tolerances are assumed, has less to lose than the penalty
            best = max(best, float(beyond.sum() - 0.5 * max(fit.penalty - fall, 0.0)))
    return best + occam_factor


def log_likelihood(excess: Real) -> Real:
    """Student-t log likelihood of groups with so much chi-square beyond a right twin's."""
    return np.asarray(-0.5 * MODEL_ERRORS * np.log1p(excess / MODEL_ERRORS))


def probabilities(log_evidence: Real) -> Real:
    """Normalised probabilities of alternatives with equal prior odds, tempered.

    >>> probabilities(np.array([0.0, 0.0])).tolist()
    [0.5, 0.5]
    """
    weight = np.exp((log_evidence - np.max(log_evidence)) / TEMPERATURE)
    return np.asarray(weight / weight.sum())
