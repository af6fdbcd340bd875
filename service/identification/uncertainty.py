"""Standard deviations: from the Jacobian, widened where residuals show that the model is wrong, and carried further."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from service.identification.least_squares import covariance_of
from service.identification.plane_model import PlaneModel
from service.identification.refine import TIGHTENED, Refined
from service.identification.zoh import Complex, Real

ESTIMATED_WEIGHTS = 1.06
"""What whitening with an estimated instead of the true covariance adds to the mean square of six-block data."""


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the fitted parameters."""

    covariance: Real
    """(n, n) to be reported."""
    from_data: Real
    """(n, n) what noise alone brings, the directions that only a prior fixes held."""
    free: NDArray[np.bool_]
    adequate: bool
    """Whether the residuals are of the size of the noise."""
    widening: float
    """Largest factor by which a standard deviation is larger than noise alone would make it."""
    scale: float
    """Residuals in units of what the weights allow for."""

    def std(self, model: PlaneModel, of: Callable[[PlaneModel], Real]) -> tuple[Real, Real]:
        """Standard deviations of functions of the model: reported, and from data alone.

        Linear error propagation with central differences; complex values count as two.
        """
        gradient = self.gradient(model, of)
        total = np.sqrt(np.maximum(np.einsum("kn,nm,km->k", gradient, self.covariance, gradient), 0.0))
        data = np.sqrt(np.maximum(np.einsum("kn,nm,km->k", gradient, self.from_data, gradient), 0.0))
        return total, data

    def gradient(self, model: PlaneModel, of: Callable[[PlaneModel], Real]) -> Real:
        """Derivatives of ``of`` to the free parameters, (K, n)."""
        size = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        columns = []
        for place, std in zip(np.flatnonzero(self.free), size, strict=True):
            value = abs(model.theta[place])
            step = min(0.1 * std, 1e-5 * value) if value > 0 and std > 0 else max(1e-6 * value, 1e-12)
            up, down = model.theta.copy(), model.theta.copy()
            up[place] += step
            down[place] -= step
            columns.append((of(model.at(up)) - of(model.at(down))) / (2 * step))
        return np.stack(columns, axis=-1)


def uncertainty_of(refined: Refined, n_prior_rows: int, level: float = 0.999) -> Uncertainty:
    """Covariance of a joint fit.

    The data's own covariance is (J^T J)^-1. When the residuals are larger than the noise beyond doubt, the model is
    wrong somewhere, and the parameters move with its error. The covariance is then, parameter by parameter, the larger
    of two: the one scaled by the residual variance, and the sandwich over bands of lines, whose errors go together.
    """
    jacobian, residual = refined.fit.jacobian, refined.fit.residual
    n_data = len(residual) - n_prior_rows
    data_rows, rest = jacobian[:n_data], residual[:n_data]
    dof = max(n_data - jacobian.shape[1], 1)
    chi = float(rest @ rest)
    scale = np.sqrt(chi / dof)
    total = covariance_of(jacobian)
    # noise alone: the prior's share of the information leaves P^-1 - Jp^T Jp, so cov_data = P Jd^T Jd P
    part = data_rows @ total
    from_data = part.T @ part
    adequate = refined.relative == 0 and chi < ESTIMATED_WEIGHTS * chi2.ppf(level, dof)
    widening = 1.0
    if not adequate:
        prior_part = (total - from_data) * (1.0 if refined.relative == 0 else TIGHTENED**-2)
        scaled = from_data * max(scale, 1.0) ** 2
        sandwich = _sandwich(part, rest)
        growth = np.sqrt(np.maximum(np.diag(scaled), np.diag(sandwich)) / np.maximum(np.diag(scaled), 1e-300))
        from_wrong = scaled * np.outer(growth, growth)
        new = from_wrong + prior_part
        widening = float(np.max(np.sqrt(np.diag(new) / np.diag(total))))
        total = new
    return Uncertainty(total, from_data, refined.fit.free, bool(adequate), widening, float(scale))


def _sandwich(influence: Real, residual: Real, bands: int = 24) -> Real:
    """Covariance of the estimate from sums of influence times residual over bands of rows.

    ``influence`` (N, n) is J (J^T J)^-1.
    """
    n = len(residual)
    edges = np.linspace(0, n, 2 * bands + 1).astype(int)
    sums = np.array([influence[a:b].T @ residual[a:b] for a, b in pairwise(edges) if b > a])
    count = len(sums)
    return np.asarray(sums.T @ sums * count / max(count - influence.shape[1] / 2, 1.0))


def response_std(model: PlaneModel, uncertainty: Uncertainty, omega: Real) -> Real:
    """Standard deviation of the model's u->y response, (P, 2, 2), E|dG|^2 = std^2."""

    def flat(m: PlaneModel) -> Real:
        g: Complex = m.response(omega)
        return np.concatenate([g.real.ravel(), g.imag.ravel()])

    std, _ = uncertainty.std(model, flat)
    half = len(std) // 2
    return np.asarray(np.sqrt(std[:half] ** 2 + std[half:] ** 2).reshape(len(omega), 2, 2))
