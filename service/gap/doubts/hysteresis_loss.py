"""Whether the lag that makes hysteresis what it is can be seen: its law has a change of stiffness beside it.

A dead band or a sensor that is not linear changes the force in phase with the current only. In noise the law of
hysteresis, of any width, comes close enough to those to seem beyond doubt. So the changes in phase with the current and
across it are fitted apart, beside everything else: of hysteresis, both are there in full.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.evidence import prior_precision
from service.gap.fitting.fit import Problem
from service.gap.which.explained import Explained
from sim.effects import CATALOGUE
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

HYSTERESIS = "magnetic_hysteresis"
HALF = 0.5
"""Share of its lag below which there is no hysteresis: two laws of it differ by less."""
DEVIATIONS = 2.0
"""Standard deviations by which the lag must be below that share."""
UNKNOWN = 10.0
"""Standard deviation of both shares before the fit: where no current reaches the law's width, the data tell nothing."""


def lag_missing(e: Explained) -> str | None:
    """Why the best explanation's hysteresis is none, in words; None where it is, or where the data cannot tell."""
    if HYSTERESIS not in e.order[0].candidate.effects:
        return None
    share, std = lag_share(e)
    if share + DEVIATIONS * std >= HALF:
        return None
    return (
        f"the force changes with amplitude, but not as with hysteresis: of the lag that goes with it "
        f"{100 * max(share, 0.0):.0f} % is there, with a standard deviation of {100 * std:.0f} %"
    )


def lag_share(e: Explained) -> tuple[float, float]:
    """Share of the fitted hysteresis's lag that the data show, and its standard deviation."""
    c = e.order[0].candidate
    problem = Problem.of(e.ground, c.fit)
    begin = sum(len(CATALOGUE[name].parameters) for name in c.effects[: c.effects.index(HYSTERESIS)])
    own = range(begin, begin + len(CATALOGUE[HYSTERESIS].parameters))
    without = e.ground.fitted_rig(c.fit.theta, c.fit.inherited)
    for name, values in zip(c.effects, c.fit.values, strict=True):
        if name != HYSTERESIS:
            without = CATALOGUE[name].on(without, **values)
    linear = problem.linearised(c.fit)
    beside = [k for k in range(len(linear.pull)) if k - problem.unknowns.n_nuisance not in own]
    curvature, gradient = prior_precision(problem.unknowns)[np.ix_(beside, beside)], linear.pull[beside]
    curvature, gradient = np.pad(curvature, (0, 2)), np.pad(gradient, (0, 2))
    curvature[[-2, -1], [-2, -1]] = UNKNOWN**-2
    for o, weight, residual, columns in zip(
        e.ground.observations, linear.weights, linear.residuals, linear.columns, strict=True
    ):
        f = o.fundamental
        change = (problem.model.predict(c.fit.rig, o, False) - problem.model.predict(without, o, False))[:, f]
        model = linear_model(without, o.frequency_hz)
        G = model.y_per_i[o.line]
        current = (model.i_per_u[o.line] @ o.U[:, f, :, None])[..., 0]
        force = np.linalg.solve(G, change[..., None])[..., 0]
        more = np.divide(force, current, out=np.zeros_like(force), where=current != 0)
        apart = [(G @ (of * current)[..., None])[..., 0] * weight[:, f] for of in (more.real, 1j * more.imag)]
        J = np.concatenate([columns[..., beside], np.stack(apart, axis=-1)], axis=-1)
        rows = _real(J.reshape(-1, J.shape[-1]))
        curvature += rows.T @ rows
        gradient += rows.T @ _real(residual.reshape(-1, 1))[:, 0]
    covariance = np.linalg.inv(curvature)
    widened = max(1.0, c.fit.chi_square / c.fit.n_residuals)
    return float(1 + (covariance @ gradient)[-1]), float(np.sqrt(covariance[-1, -1] * widened))


def _real(z: Complex) -> Real:
    return np.concatenate([z.real, z.imag])
