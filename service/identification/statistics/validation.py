"""Validation: NRMSE fit (eq. 6.1), whiteness and independence of the residuals, and how large they are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.distributions import f_tail, normal_above
from service.identification.arrays import Complex, Real
from service.identification.statistics.portmanteau import portmanteau

LEVEL = 0.99


def nrmse_percent(measured: Complex, model: Complex) -> float:
    """Fit of eq. 6.1, percent: 100 (1 - ||G - Gm|| / ||G - mean G||) over the frequencies.

    >>> g = np.array([1.0 + 1j, 2.0, 4.0])
    >>> nrmse_percent(g, g), nrmse_percent(g, np.full(3, g.mean()))
    (100.0, 0.0)
    """
    spread = float(np.linalg.norm(measured - measured.mean()))
    if spread == 0:
        return 100.0 if np.allclose(measured, model) else -math.inf
    return 100.0 * (1.0 - float(np.linalg.norm(measured - model)) / spread)


def nrmse_matrix(measured: Complex, model: Complex) -> Real:
    """Fit of every entry, (n_out, n_in), of two responses (F, n_out, n_in)."""
    _, rows, columns = measured.shape
    return np.array([[nrmse_percent(measured[:, a, b], model[:, a, b]) for b in range(columns)] for a in range(rows)])


@dataclass(frozen=True)
class CorrelationTest:
    """A correlation function of residuals along frequency with its bound."""

    name: str
    lags: Real
    """(L,) in measured lines."""
    correlation: Real
    """(L,) real part, normalised."""
    bound: float
    """What white residuals stay within at `LEVEL`, lag by lag."""
    statistic: float
    """Sum over the lags, of white residuals of expectation ``degrees_of_freedom``: a chi-square for long records."""
    degrees_of_freedom: int
    p_value: float
    """Of its own distribution at this number of residuals."""

    def document(self) -> dict[str, object]:
        """As JSON."""
        return {
            "statistic": self.statistic,
            "degrees_of_freedom": self.degrees_of_freedom,
            "p_value": self.p_value,
            "bound": self.bound,
            "lags": [int(k) for k in self.lags],
            "correlation": self.correlation.tolist(),
        }


def whiteness(name: str, residual: Complex, max_lag: int = 15) -> CorrelationTest:
    """Correlation of a residual with itself at neighbouring lines.

    ``residual`` (F,) in units of its noise, ascending in frequency.
    """
    n = len(residual)
    lags = np.arange(1, min(max_lag, n // 3) + 1, dtype=np.int64)
    rho, statistic, p_value = portmanteau(residual, lags)
    return _test(name, lags.astype(float), rho, n, statistic, 2 * len(lags), p_value)


def independence(name: str, residual: Complex, direction: Complex, max_lag: int = 8) -> CorrelationTest:
    """Correlation of a residual with what the model says there: what is left of the input in it.

    ``direction`` (F,) is the model's response; only its phase counts, so a relative error shows as a real correlation
    and an error of phase as an imaginary one.
    """
    n = len(residual)
    lags = np.arange(-min(max_lag, n // 4), min(max_lag, n // 4) + 1)
    unit = direction / np.maximum(np.abs(direction), 1e-300)
    size = float(np.sqrt(np.mean(np.abs(residual) ** 2))) or 1.0
    shifted = np.zeros((n, len(lags)), dtype=complex)
    for c, k in enumerate(lags):
        if k >= 0:
            shifted[k:, c] = unit[: n - k]
        else:
            shifted[:k, c] = unit[-k:]
    rho = shifted.conj().T @ residual / (n * size)
    # the direction turns slowly, so lags go together: only independent combinations count
    left, singular, _ = np.linalg.svd(shifted, full_matrices=False)
    basis = left[:, singular > 0.05 * singular[0]]
    statistic = float(2 * np.sum(np.abs(basis.conj().T @ residual) ** 2) / size**2)
    # what a plane of m of n dimensions holds of a white residual of whatever size, against what is left beside it, is F
    m = basis.shape[1]
    beside = max(2 * n - statistic, 1e-300)
    p_value = float(f_tail(statistic * (n - m) / (beside * m), 2 * m, 2 * (n - m))) if n > m else 1.0
    return _test(name, lags.astype(float), rho, n, statistic, 2 * m, p_value)


def _test(name: str, lags: Real, rho: Complex, n: int, statistic: float, dof: int, p_value: float) -> CorrelationTest:
    bound = float(normal_above(0.5 - LEVEL / 2) / math.sqrt(2 * n))
    return CorrelationTest(name, lags, np.asarray(rho.real), bound, statistic, dof, p_value)


def all_pass(tests: list[CorrelationTest], level: float = LEVEL) -> bool:
    """Whether no test rejects at a joint ``level`` (Holm's bound on the smallest p-value)."""
    return all(t.p_value > (1 - level) / max(len(tests), 1) for t in tests)
