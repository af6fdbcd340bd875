"""The result of a fit of a part of the loop, and its linearisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.effect import End
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]


LEAST_PRECISION = 1e-9
"""Precision of the prior, in units of that of a tolerance, below which a direction has none."""
OUT_OF_STEPS = "reached the largest number of iterations"
"""Status of a fit that has not converged and could go on."""


@dataclass(frozen=True, eq=False)
class TradeOff:
    """How chi-square rises as the penalty of the nuisance values falls, along directions that do not interact.

    Both are parabolas about the minimum of their sum. With chi-square weighted by w < 1 the minimum lies nearer to the
    mean of the prior, and follows from here.
    """

    penalty: Real
    """(d,) the penalty's part along each direction"""
    stiffness: Real
    """(d,) curvature of chi-square over that of the penalty"""

    @classmethod
    def at(cls, away: Real, curvature: Real, prior: Real, free: Mask) -> TradeOff:
        """At a minimum.

        Parameters
        ----------
        away
            Unknowns less the mean of their prior, (m,).
        curvature, prior
            J^T J of the weighted residuals, and precision of the prior, zero for unknowns without one, (m, m) each.
        free
            Which unknowns may move, (m,).
        """
        priced = np.diag(prior) > 0
        k, others = np.flatnonzero(free & priced), np.flatnonzero(free & ~priced & (np.diag(curvature) > 0))
        follow = np.linalg.lstsq(curvature[np.ix_(others, others)], curvature[np.ix_(others, k)], rcond=None)[0]
        own = curvature[np.ix_(k, k)] - curvature[np.ix_(k, others)] @ follow
        precision, directions = np.linalg.eigh(prior[np.ix_(k, k)])
        known = precision > LEAST_PRECISION
        whitening = directions[:, known] / np.sqrt(precision[known])
        stiffness, along = np.linalg.eigh(whitening.T @ own @ whitening)
        pull = whitening.T @ (prior @ away)[k]  # values that are held pull at the others
        return cls((along.T @ pull) ** 2, np.maximum(stiffness, 0.0))

    def at_weight(self, weight: float) -> tuple[float, float]:
        """Rise of chi-square and fall of the penalty at the minimum of w chi-square + penalty, 0 < w <= 1.

        >>> TradeOff(np.array([1.0]), np.array([1.0])).at_weight(1.0)
        (0.0, 0.0)
        """
        back = (1 - weight) / (1 + weight * self.stiffness)
        rise = self.penalty * back * (2 + self.stiffness * back)
        return float(rise.sum()), float((self.penalty * (1 - (1 - back) ** 2)).sum())


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted twin, or one part of it."""

    effects: tuple[str, ...]
    theta: Real
    """(k,) deviations from the datasheet, in units of the tolerances"""
    values: tuple[dict[str, float], ...]
    """parameters of each effect"""
    rig: Rig
    groups: tuple[tuple[float, int], ...]
    """(chi-square, number of residuals) of the fundamental, then of the other harmonics, for each sweep in turn"""
    penalty: float
    """of the values fitted, as a chi-square: |theta|^2 where the datasheet states its tolerances, less where they are
    assumed; of values inherited from another part, by the precision that its data gave"""
    active: NDArray[np.int64]
    """(a,) indices of the nuisance values fitted"""
    curvature: Real
    """(a + e, a + e), J^T J of the weighted residuals; effect parameters in units of their scale"""
    status: str
    inherited: tuple[dict[str, float], ...] = ()
    """parameters of uncertain effects of another part, fitted again here; last in ``curvature``"""
    across: tuple[tuple[float, int], ...] = ()
    """as ``groups``, of the fundamental in the plane that was not excited, for each sweep; contained in ``groups``"""
    ends: Mapping[tuple[str, str], End] = field(default_factory=dict)
    """(effect, parameter) that ended at an end of its range, and which end"""
    trade_off: TradeOff | None = None
    """of chi-square and penalty; None where it is not known"""

    @property
    def out_of_steps(self) -> bool:
        """Whether it ended before it converged."""
        return self.status == OUT_OF_STEPS

    @property
    def chi_square(self) -> float:
        """Of the weighted residuals, all harmonics."""
        return sum(chi for chi, _ in self.groups)

    @property
    def cost(self) -> float:
        """Chi-square and penalty: what was minimised."""
        return self.chi_square + self.penalty

    @property
    def n_residuals(self) -> int:
        """Number of weighted residuals, real and imaginary parts apart."""
        return sum(n for _, n in self.groups)


@dataclass(frozen=True)
class Linearised:
    """A fit as a linear problem about its solution, to which further regressors can be added; fundamentals only."""

    weights: Sequence[Real]
    """(P, H, n) per sweep"""
    residuals: Sequence[Complex]
    """(P, n) per sweep, weighted"""
    columns: Sequence[Complex]
    """(P, n, a + e) per sweep, weighted derivatives of the predictions"""
    pull: Real
    """(a + e,) pull of the prior at the solution: precision (mean - x), added to J^T r"""
