"""Scores of competing models: what a better fit is worth against the parameters that it costs."""

from __future__ import annotations

import math
from dataclasses import dataclass


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

    @property
    def _fit(self) -> float:
        return self.n_data * math.log(max(self.cost, 1e-300) / self.n_data)


def best(candidates: list[Evidence], clear: float = 10.0) -> int:
    """Place of the candidate to keep: the simplest one that none beats clearly by description length."""
    order = sorted(range(len(candidates)), key=lambda k: candidates[k].n_parameters)
    kept = order[0]
    for k in order[1:]:
        if candidates[k].mdl < candidates[kept].mdl - clear:
            kept = k
    return kept
