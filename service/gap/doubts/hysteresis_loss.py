"""Whether the loss that distinguishes hysteresis is in the data, and not only its change of gain with amplitude.

A dead band or a nonlinear sensor changes the force in phase with the current only. In noise a hysteresis with plays of
a suitable width may fit that well enough to be named. So the describing function of the fitted hysteresis is split into
its real part (gain) and its imaginary part (lag), and a share of each is fitted beside all other unknowns: hysteresis
has both in full.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.evidence import prior_precision
from service.gap.fitting.fit import Problem
from service.gap.measured.observation import Observation
from service.gap.which.explained import Explained
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

HYSTERESIS = "magnetic_hysteresis"
HALF = 0.5
"""Share of the lag below which there is no hysteresis: two laws of it differ by less."""
DEVIATIONS = 2.0
"""Standard deviations by which the share must be below that."""
UNKNOWN = 10.0
"""Prior standard deviation of both shares: where no current reaches the width of a play, the data do not show them."""


def lag_missing(e: Explained) -> str | None:
    """Why the best explanation's hysteresis is rejected, in words; None where it is not, or there is none."""
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
    own = [k for k, (which, _) in enumerate(problem.unknowns.own) if c.effects[which] == HYSTERESIS]
    without = e.ground.fitted_rig(c.fit.theta, c.fit.inherited)
    for name, values in zip(c.effects, c.fit.values, strict=True):
        if name != HYSTERESIS:
            without = CATALOGUE[name].on(without, **values)
    linear = problem.linearised(c.fit)
    # normal equations of all other unknowns, then of the changes of both shares from one
    beside = [k for k in range(len(linear.pull)) if k - problem.unknowns.n_nuisance not in own]
    curvature, gradient = prior_precision(problem.unknowns)[np.ix_(beside, beside)], linear.pull[beside]
    curvature, gradient = np.pad(curvature, (0, 2)), np.pad(gradient, (0, 2))
    curvature[[-2, -1], [-2, -1]] = UNKNOWN**-2
    for o, weight, residual, columns in zip(
        e.ground.observations, linear.weights, linear.residuals, linear.columns, strict=True
    ):
        f = o.fundamental
        change = (problem.model.predict(c.fit.rig, o, False) - problem.model.predict(without, o, False))[:, f]
        of_parts = [part * weight[:, f] for part in _by_gain_and_lag(change, without, o)]
        J = np.concatenate([columns[..., beside], np.stack(of_parts, axis=-1)], axis=-1)
        rows = _real(J.reshape(-1, J.shape[-1]))
        curvature += rows.T @ rows
        gradient += rows.T @ _real(residual.reshape(-1, 1))[:, 0]
    covariance = np.linalg.inv(curvature)
    widened = max(1.0, c.fit.chi_square / c.fit.n_residuals)
    return float(1 + (covariance @ gradient)[-1]), float(np.sqrt(covariance[-1, -1] * widened))


def _by_gain_and_lag(change: Complex, rig: Rig, o: Observation) -> tuple[Complex, Complex]:
    """A change of y, (P, n), split into those by the real and by the imaginary part of its describing function.

    That is the force that makes the change over the coil current.
    """
    model = linear_model(rig, o.frequency_hz)
    G = model.y_per_i[o.line]
    current = (model.i_per_u[o.line] @ o.U[:, o.fundamental, :, None])[..., 0]
    force = np.linalg.solve(G, change[..., None])[..., 0]
    gain = np.divide(force, current, out=np.zeros_like(force), where=current != 0)
    by_gain, by_lag = ((G @ (part * current)[..., None])[..., 0] for part in (gain.real, 1j * gain.imag))
    return by_gain, by_lag


def _real(z: Complex) -> Real:
    """Real parts, then imaginary ones."""
    return np.concatenate([z.real, z.imag])
