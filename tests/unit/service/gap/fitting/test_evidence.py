"""Evidence counts an error of a law once: not as misfit of what other data say of the values that took it up, too."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from service.gap.fitting.evidence import MODEL_ERRORS, log_evidence
from service.gap.fitting.fitted import Fit, TradeOff
from sim.reference import reference_rig

RNG = np.random.default_rng(5)
ROOT = RNG.normal(size=(30, 5))
MEASURED = 40.0 * RNG.normal(size=30)
PRIOR = np.diag([1.0, 4.0, 9.0, 25.0, 0.0])
PRIOR[1, 2] = PRIOR[2, 1] = 3.0
MEAN = np.array([0.0, 0.5, -1.0, 0.0, 0.0])
"""Chi-square |MEASURED - ROOT x|^2 and a penalty; the last unknown has no prior, as a parameter of an effect."""


def chi_square(x: np.ndarray) -> float:
    return float(np.sum((MEASURED - ROOT @ x) ** 2))


def penalty(x: np.ndarray) -> float:
    return float((x - MEAN) @ PRIOR @ (x - MEAN))


def minimum(weight: float, held: dict[int, float] | None = None) -> np.ndarray:
    """Of weight x chi-square + penalty, by the normal equations, with some unknowns held."""
    hessian, pull = weight * ROOT.T @ ROOT + PRIOR, weight * ROOT.T @ MEASURED + PRIOR @ MEAN
    for k, value in (held or {}).items():
        pull = pull - hessian[:, k] * value
        hessian[k], hessian[:, k], hessian[k, k], pull[k] = 0.0, 0.0, 1.0, value
    return np.linalg.solve(hessian, pull)


@pytest.mark.parametrize("held", [{}, {1: 4.0}], ids=["all free", "one at its bound"])
@pytest.mark.parametrize("weight", [0.5, 1e-2, 1e-4])
def test_the_trade_off_is_that_of_the_two_parabolas(weight: float, held: dict[int, float]) -> None:
    x, there = minimum(1.0, held), minimum(weight, held)
    free = np.array([k not in held for k in range(5)])
    trade_off = TradeOff.at(x - MEAN, ROOT.T @ ROOT, PRIOR, free)
    rise, fall = trade_off.at_weight(weight)
    assert rise == pytest.approx(chi_square(there) - chi_square(x), rel=1e-6)
    assert fall == pytest.approx(penalty(x) - penalty(there), rel=1e-6)


def a_fit(x: np.ndarray, known: bool = True) -> Fit:
    trade_off = TradeOff.at(x - MEAN, ROOT.T @ ROOT, PRIOR, np.ones(5, dtype=bool)) if known else None
    groups = ((chi_square(x), 30), (0.0, 0))
    rig = reference_rig()
    return Fit((), x, (), rig, groups, penalty(x), np.arange(5), np.eye(5), "converged", trade_off=trade_off)


def test_where_much_is_left_the_evidence_is_that_of_the_likeliest_values() -> None:
    """Student-t likelihood, maximised by a general optimiser, not that at the minimum of chi-square and penalty."""
    x = minimum(1.0)

    def loss(at: np.ndarray) -> float:
        return 0.5 * MODEL_ERRORS * np.log1p(max(chi_square(at) - 30.0, 0.0) / MODEL_ERRORS) + 0.5 * penalty(at)

    likeliest = -minimize(loss, x, method="BFGS").fun
    at_the_fit = -loss(x)
    assert likeliest > at_the_fit + 5.0
    assert log_evidence(a_fit(x, known=False), 0.0, (30.0, 0.0)) == pytest.approx(at_the_fit)
    assert log_evidence(a_fit(x), 0.0, (30.0, 0.0)) == pytest.approx(likeliest, abs=0.1)


def test_no_step_back_gains_more_than_the_price_of_the_values() -> None:
    """Where tolerances are assumed, values off cost less than the fit minimised; nothing is won beyond that."""
    x = minimum(1.0)
    cheap = replace(a_fit(x), penalty=0.1)
    likelihood = -0.5 * MODEL_ERRORS * np.log1p((chi_square(x) - 30.0) / MODEL_ERRORS)
    assert log_evidence(cheap, 0.0, (30.0, 0.0)) <= likelihood


def test_what_noise_alone_leaves_is_judged_at_the_fit() -> None:
    x = minimum(1.0)
    at_noise = log_evidence(a_fit(x), 0.0, (chi_square(x), 0.0))
    assert at_noise == pytest.approx(-0.5 * penalty(x))
