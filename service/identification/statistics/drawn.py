"""Models drawn from an estimate's covariance, and where a figure of them lies: what the data allow as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Real

DRAWS = 100
LEVEL = 0.95


class Parametric(Protocol):
    """A model that other parameters make another one of."""

    @property
    def theta(self) -> Real:
        """Parameters, (size,)."""

    @property
    def is_physical(self) -> bool:
        """Whether a rotor can be so."""

    def at(self, theta: Real) -> Self:
        """The same with other parameters."""


Model = TypeVar("Model", bound=Parametric)


@dataclass(frozen=True)
class Interval:
    """A figure of the best model, and where it lies with 95 % probability. None: unbounded or without meaning.

    A margin that the best model has not, and others that the data allow have, is bounded on their side alone.
    """

    value: float | None
    low: float | None
    high: float | None

    def document(self) -> dict[str, float | None]:
        """As JSON."""
        return {"value": self.value, "low": self.low, "high": self.high}


def drawn(best: Model, free: NDArray[np.bool_], covariance: Real, draws: int, seed: int) -> list[Model]:
    """Models that the data allow as well as the best one; unphysical ones are drawn again."""
    rng = np.random.default_rng(seed)
    # of numbers of one size: rounding of a stiffness' variance is many times that of a delay
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    root = unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    found: list[Model] = []
    for _ in range(3 * draws):
        if len(found) == draws:
            break
        step = np.zeros_like(best.theta)
        step[free] = root @ rng.normal(size=len(values))
        model = best.at(_moved(best.theta, step))
        if model.is_physical:
            found.append(model)
    return found


def _moved(theta: Real, step: Real) -> Real:
    """Parameters after a step, in proportion: a change of a shape's split then leaves the product of its parts."""
    share = np.divide(step, theta, out=np.full_like(theta, np.inf), where=theta != 0)
    small = np.abs(share) < 0.7
    return np.where(small, theta * np.exp(np.where(small, share, 0.0)), theta + step)


def interval(value: float | None, others: Sequence[float | None], none: float = np.inf) -> Interval:
    """95 % of the draws about a figure.

    Parameters
    ----------
    value, others
        Of the best model, and of others that the data allow as well; None where one has no such figure.
    none
        What None stands for. An end there is open; where the best model has no such margin and others have, the end on
        their side is told all the same.

    >>> interval(None, [5.0] * 60 + [None] * 40)
    Interval(value=None, low=5.0, high=None)
    """
    if not others:
        return Interval(value, None, None)
    all_of_them = [none if d is None or np.isnan(d) else d for d in others]
    best = none if value is None else value
    low = np.quantile(all_of_them, (1 - LEVEL) / 2, method="lower")
    high = np.quantile(all_of_them, (1 + LEVEL) / 2, method="higher")
    ends = (float(min(low, best)), float(max(high, best)))
    return Interval(value, *(end if np.isfinite(end) else None for end in ends))
