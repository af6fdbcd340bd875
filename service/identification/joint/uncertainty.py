"""Standard deviations: from the Jacobian, widened where residuals show that the model is wrong, and carried further."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_above
from service.identification.arrays import Complex, Real
from service.identification.joint.refine import Refined
from service.identification.joint.residuals import residuals
from service.identification.measured.data import Data
from service.identification.measured.noise import ESTIMATED_WEIGHTS
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import HELD, Posterior
from service.identification.statistics.derivatives import central_differences, propagated_std
from service.identification.statistics.least_squares import Fit, covariance_of


class Parametrised(Protocol):
    """A model that knows its parameters."""

    @property
    def theta(self) -> Real:
        """Its parameters, (size,)."""

    def at(self, theta: Real) -> Self:
        """The same with other parameters."""


class Fitted(Protocol):
    """A joint fit in units of the noise."""

    @property
    def fit(self) -> Fit:
        """Residuals of the data first, those that hold splits last."""

    @property
    def relative(self) -> float:
        """Relative model error that the weights allow for beside the noise."""


Model = TypeVar("Model", bound=Parametrised)

INADEQUATE = "model not adequate: residuals are larger than the noise makes them, something acts that it does not have"


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the fitted parameters."""

    covariance: Real
    """(n, n) to be reported."""
    from_data: Real
    """(n, n) what noise alone brings, the shapes' splits held."""
    free: NDArray[np.bool_]
    adequate: bool
    """Whether the residuals are of the size of the noise."""
    widening: float
    """Largest factor by which a standard deviation is larger than noise alone would make it."""
    scale: float
    """Residuals in units of what the weights allow for."""

    def status(self, fit: Fit) -> str:
        """How the fit ended: whether its model is adequate first, for a search converges on a wrong model, too."""
        if self.adequate:
            return fit.status
        return f"{INADEQUATE} (search for its parameters: {fit.status})"

    def std(self, model: Model, of: Callable[[Model], Real]) -> tuple[Real, Real]:
        """Standard deviations of functions of the model: reported, and from data alone.

        Linear error propagation with central differences; complex values count as two.
        """
        gradient = self.gradient(model, of)
        return propagated_std(gradient, self.covariance), propagated_std(gradient, self.from_data)

    def gradient(self, model: Model, of: Callable[[Model], Real]) -> Real:
        """Derivatives of ``of`` to the free parameters, (K, n)."""
        std = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        value = np.abs(model.theta[self.free])
        usual, otherwise = np.minimum(0.1 * std, 1e-5 * value), np.maximum(1e-6 * value, 1e-12)
        steps = np.where((value > 0) & (std > 0), usual, otherwise)
        return central_differences(lambda theta: of(model.at(theta)), model.theta, self.free, steps)


def uncertainty_of(
    refined: Fitted,
    splits: Posterior | None,
    level: float = 0.999,
    inflation: float = ESTIMATED_WEIGHTS,
    estimated_weights: bool = False,
) -> Uncertainty:
    """Covariance of a joint fit.

    ``inflation`` is that of the noise model (`measured.noise.NoiseModel`), by default that of six blocks. Chance in
    estimated weights makes the residuals larger, and the information by the same share; with ``estimated_weights``
    that share is taken back.

    Noise brings (J^T J)^-1 with the shapes' splits held; what is not known of the splits is added along the direction
    in which the fit moves with them. When the residuals are larger than the noise beyond doubt, the model is wrong
    somewhere, and the parameters move with its error. The first part is then, parameter by parameter, the larger of
    two: the one scaled by the residual variance, and the sandwich over bands of lines, whose errors go together.
    """
    jacobian, residual = refined.fit.jacobian, refined.fit.residual
    n_held = 0 if splits is None else len(splits.log_ratios)
    n_data = len(residual) - n_held
    rest = residual[:n_data]
    dof = max(n_data - jacobian.shape[1] + n_held, 1)
    chi = float(rest @ rest)
    scale = np.sqrt(chi / dof)
    inverse = from_data = covariance_of(jacobian)
    adequate = refined.relative == 0 and chi < inflation * chi2_above(1 - level, dof)
    if adequate and estimated_weights:
        from_data = inverse * max(scale, 1.0) ** 2
    reported, widening = from_data, 1.0
    if not adequate:
        scaled = inverse * max(scale, 1.0) ** 2
        sandwich = _sandwich(jacobian[:n_data] @ inverse, rest)
        growth = np.sqrt(np.maximum(np.diag(scaled), np.diag(sandwich)) / np.maximum(np.diag(scaled), 1e-300))
        reported = scaled * np.outer(growth, growth)
        widening = float(np.max(np.sqrt(np.diag(reported) / np.diag(from_data))))
    if splits is not None:
        moves = inverse @ jacobian[n_data:].T / HELD
        reported = reported + moves @ splits.covariance @ moves.T
    return Uncertainty(reported, from_data, refined.fit.free, bool(adequate), widening, float(scale))


def with_given(u: Uncertainty, refined: Refined, data: Data, covariance: Real) -> Uncertainty:
    """The same with what is not known of what the fit held: mass, geometry and sensor gains, (7, 7) as in `GIVEN`.

    The fitted parameters move with these as the least squares of small signals do, so that a figure that only both
    together tell, as the response, keeps its deviation.
    """
    layout, free = refined.model.layout, refined.fit.free
    _, slopes = residuals(refined.model, data, refined.weights, None)
    assert slopes is not None
    moved = moved_with(slopes[:, free], slopes[:, layout.given], refined.fit.jacobian[len(slopes) :])
    across = moved @ covariance
    both = np.block([[u.covariance + across @ moved.T, across], [across.T, covariance]])
    n = len(u.from_data)
    from_data = np.zeros_like(both)
    from_data[:n, :n] = u.from_data
    whole = free.copy()
    whole[layout.given] = True
    return replace(u, covariance=both, from_data=from_data, free=whole)


def moved_with(free: Real, given: Real, beside: Real) -> Real:
    """How fitted parameters move with what a fit held, (n, m), as least squares do.

    Parameters
    ----------
    free, given
        Slopes of the data's residuals to the former, (N, n), and to the latter, (N, m).
    beside
        (K, n) slopes of what is known beside the data, as of splits: it tells nothing of what is held.
    """
    jacobian = np.vstack([free, beside])
    with_them = np.vstack([given, np.zeros((len(beside), given.shape[1]))])
    return np.asarray(-covariance_of(jacobian) @ (jacobian.T @ with_them))


def _sandwich(influence: Real, residual: Real, bands: int = 48) -> Real:
    """Covariance of the estimate from sums of influence times residual over bands of rows.

    ``influence`` (N, n) is J (J^T J)^-1. Rows go channel by channel and line by line, so that a band has neighbouring
    lines of a channel; a few reach from the last lines of one to the first of the next.
    """
    n = len(residual)
    edges = np.linspace(0, n, bands + 1).astype(int)
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
