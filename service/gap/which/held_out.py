"""Explanations of one part of the loop on unseen data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.evidence import log_likelihood, prior_precision
from service.gap.fitting.fit import Problem
from service.gap.fitting.jacobian import stacked
from service.gap.measured.observation import Observation
from service.gap.weighing.shrinkage import closure_of
from service.gap.weighing.significance import mean_power, overall, significance
from service.gap.weighing.verdict import HeldOut
from service.gap.which.explained import Explained

Complex = NDArray[np.complex128]


def on_sweep(e: Explained, candidate: Candidate, o: Observation) -> tuple[Observation, Complex]:
    """A sweep with the input of the part as its fits have it, and a candidate's weighted residuals there, (P, H, n)."""
    o = e.ground.as_input(o)
    there = Problem.of(replace(e.ground, observations=(o,)), candidate.fit)
    return o, there.residuals(candidate.fit)[0]


def held_out(e: Explained, unseen: Observation) -> HeldOut:
    """Residuals of a part on the unseen sweep, with the plain twin and with the best explanation."""
    o, before = on_sweep(e, e.null.candidate, unseen)
    _, after = on_sweep(e, e.order[0].candidate, unseen)
    f = o.fundamental
    gap, left = (max(significance(z[:, [f]], o), overall(z[:, f])) for z in (before, after))
    J_b, J_a, J_fb, J_fa = map(mean_power, (before, after, before[:, f], after[:, f]))
    fundamental = np.arange(before.shape[1]) == f
    support = 0.0
    for group in (fundamental, ~fundamental):
        b, a = (float(np.sum(np.abs(z[:, group]) ** 2)) for z in (before, after))
        noise = min(float(2 * before[:, group].size), a, b)
        support += float(log_likelihood(np.array(a - noise)) - log_likelihood(np.array(b - noise)))
    closes = closure_of(J_fb, J_fa)
    return HeldOut(J_b, J_a, gap, left, 1.0 if closes is None else closes, support)


def between_lines(e: Explained, unseen: Observation, there: HeldOut) -> HeldOut:
    """The test of `held_out` where the unseen lines are of the fitted sweep itself, allowing for the fit's uncertainty.

    The lines between few fitted ones may depend on values that these do not determine. So the explanation's values may
    follow the unseen lines, with the posterior of the fit as their prior; residuals that remain contradict it.
    """
    if not there.fails:
        return there
    best = e.order[0].candidate
    o, before = on_sweep(e, e.null.candidate, unseen)
    problem = Problem.of(replace(e.ground, observations=(o,)), best.fit)
    linear, f = problem.linearised(best.fit), o.fundamental
    (z,), (J,) = linear.residuals, linear.columns
    rows = stacked(J)
    known = best.fit.curvature + prior_precision(problem.unknowns)
    moved = np.linalg.solve(known + rows.T @ rows, rows.T @ stacked(z[..., None])[:, 0])
    remaining = (z - J @ moved)[:, None]
    closes = closure_of(mean_power(before[:, f]), mean_power(remaining))
    left = max(significance(remaining, o), overall(remaining))
    return replace(there, left=left, closes=1.0 if closes is None else closes)
