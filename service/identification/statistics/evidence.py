"""Scores of competing models: what a better fit is worth against the parameters that it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.identification.arrays import Real


@dataclass(frozen=True)
class Evidence:
    """One candidate and its scores; lower is better for each."""

    name: str
    n_parameters: int
    n_data: int
    cost: float
    """Sum of squares in units of the noise."""
    chosen: bool = False
    note: str = ""
    leave_one_out_rms: float | None = None
    """Cross-validation within the data: residual over noise of each value, predicted by a fit without it."""
    unseen_rms: float | None = None
    """Cross-validation on a sweep that no fit has seen: residual over noise. None without such a sweep."""

    @property
    def rms(self) -> float:
        """Root mean square residual over the noise: 1 when the model is right."""
        return math.sqrt(self.cost / max(self.n_data - self.n_parameters, 1))

    @property
    def aic(self) -> float:
        """Akaike's criterion, the noise level unknown."""
        return self._fit + 2 * self.n_parameters

    @property
    def mdl(self) -> float:
        """Minimum description length (Rissanen), the noise level unknown."""
        return self._fit + self.n_parameters * math.log(self.n_data)

    @property
    def fpe(self) -> float:
        """Akaike's final prediction error, in units of the noise variance."""
        n, k = self.n_data, self.n_parameters
        return self.cost / n * (n + k) / max(n - k, 1)

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "name": self.name,
            "parameters": self.n_parameters,
            "data": self.n_data,
            "cost": self.cost,
            "rms_over_sigma": self.rms,
            "aic": self.aic,
            "mdl": self.mdl,
            "fpe": self.fpe,
            "leave_one_out_rms": self.leave_one_out_rms,
            "cross_validation_rms": self.unseen_rms,
            "chosen": self.chosen,
            "note": self.note,
        }

    @property
    def _fit(self) -> float:
        return self.n_data * math.log(max(self.cost, 1e-300) / self.n_data)


def leave_one_out(residual: Real, jacobian: Real) -> float:
    """Root mean square of r_k/(1 - h_k), the residual of value k by a fit without it.

    h is the diagonal of J (J^T J)^-1 J^T; exact where the model is linear about its optimum (Allen's PRESS).

    >>> leave_one_out(np.array([1.0, -1.0, 1.0, -1.0]), np.ones((4, 1)))
    1.3333333333333333
    """
    norms = np.linalg.norm(jacobian, axis=0)
    q, _ = np.linalg.qr(jacobian / np.where(norms > 0, norms, 1.0))
    leverage = np.minimum(np.einsum("nk,nk->n", q, q), 1 - 1e-9)
    return float(np.sqrt(np.mean((residual / (1.0 - leverage)) ** 2)))


def best(candidates: list[Evidence], clear: float = 10.0) -> int:
    """Place of the candidate to keep: the simplest one that none beats clearly by description length."""
    order = sorted(range(len(candidates)), key=lambda k: candidates[k].n_parameters)
    kept = order[0]
    for k in order[1:]:
        if candidates[k].mdl < candidates[kept].mdl - clear:
            kept = k
    return kept
