"""What a fit of a part of the loop ends with: the twin, what it leaves, and the fit as a linear problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.effect import End
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


OUT_OF_STEPS = "reached the largest number of iterations"
"""Status of a fit that could go on."""


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
    """(chi-square, number of residuals) of the fundamental and of the other harmonics, sweep by sweep"""
    penalty: float
    """of the values fitted, what the datasheet's tolerances hold against them, |theta|^2 where it states them; of
    another part's values what its data hold against them"""
    active: NDArray[np.int64]
    """indices of the values fitted"""
    curvature: Real
    """(a + e, a + e), J^T J of the weighted residuals; effect parameters in units of their scale"""
    status: str
    inherited: tuple[dict[str, float], ...] = ()
    """parameters of the effects that are another part's and uncertain, last in ``curvature``"""
    across: tuple[tuple[float, int], ...] = ()
    """as ``groups``, of the fundamental in the plane that was not excited alone, sweep by sweep; part of those"""
    ends: Mapping[tuple[str, str], End] = field(default_factory=dict)
    """effects' parameters, by effect and name, that the fit left at an end of their range, and which"""

    @property
    def out_of_steps(self) -> bool:
        """Whether it ended before it settled."""
        return self.status == OUT_OF_STEPS

    @property
    def chi_square(self) -> float:
        """Of the weighted residuals, all harmonics."""
        return sum(chi for chi, _ in self.groups)

    @property
    def cost(self) -> float:
        """What was minimised: chi-square and the price of the datasheet's values."""
        return self.chi_square + self.penalty

    @property
    def n_residuals(self) -> int:
        """Number of weighted residuals, real and imaginary parts apart."""
        return sum(n for _, n in self.groups)


@dataclass(frozen=True)
class Linearised:
    """A fit as a linear problem, for what is asked beside it; sweep by sweep, at the excited frequency."""

    weights: Sequence[Real]
    """(P, H, n)"""
    residuals: Sequence[Complex]
    """(P, n) weighted"""
    columns: Sequence[Complex]
    """(P, n, a + e) weighted derivatives of the predictions"""
    pull: Real
    """(a + e,) of what is known beforehand, towards its mean"""
