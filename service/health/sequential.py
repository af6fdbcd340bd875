"""When a change counts as an alarm: false alarms are rare over a year of checks, whatever the number of figures.

Every check tests some thirty figures, every day, against one and the same commissioning. Three things follow.

* The level of one test is the year's allowance divided among all tests of the year (Bonferroni). The expected number
  of false alarms is then at most the allowance however the figures hang together, and also however the days do: the
  baseline's error is the same every day, so days are not independent, but an expected number is a sum, and each term
  of it holds the baseline's variance beside the check's own.
* A scheduler may check more often than daily. Half of the allowance is spread over the first 365 checks of a year, the
  other half over all later ones by a series that converges, so no cadence exceeds the whole (alpha spending: Lan and
  DeMets, Biometrika 70, 1983).
* Standard deviations come from the scatter of few blocks, so the tails are Student's, not Gauss's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from service.distributions import student_above, student_tail
from service.identification.arrays import Real
from sim.errors import AmbError

CHECKS_A_YEAR = 365
ALLOWANCE = 0.2
"""False alarms that a rig may have in a year, on average: one in five years."""


@dataclass(frozen=True)
class Policy:
    """How many false alarms a rig may have."""

    per_year: float = ALLOWANCE
    """Expected number of false alarms of one rig in a year, all figures together; at most 1."""

    def __post_init__(self) -> None:
        if not 0 < self.per_year <= 1:
            raise AmbError(f"false alarms per year are {self.per_year:g}; give a number above 0 and at most 1")

    def level(self, tests_made: int, n_figures: int) -> float:
        """Probability of a false alarm that one figure of one check may have.

        Parameters
        ----------
        tests_made
            Checks of this rig in the 365 days before this one.
        n_figures
            Figures that this check tests.

        >>> round(1 / (365 * 30 * Policy(1.0).level(10, 30)))
        2
        """
        n = tests_made + 1
        if n <= CHECKS_A_YEAR:
            share = 0.5 / CHECKS_A_YEAR
        else:  # the sum over n > 365 of 365 / (n (n - 1)) is one
            share = 0.5 * CHECKS_A_YEAR / (n * (n - 1))
        return self.per_year * share / max(n_figures, 1)

    def threshold(self, tests_made: int, n_figures: int, freedom: float) -> float:
        """The same as a number of standard deviations.

        >>> round(Policy().threshold(0, 30, 500.0), 2)
        4.48
        """
        return float(student_above(0.5 * self.level(tests_made, n_figures), freedom))


def p_values(change: ArrayLike, std: ArrayLike, freedom: float) -> Real:
    """Probability of a change at least that large where nothing changed, two-sided.

    Parameters
    ----------
    change, std
        Differences, and their standard deviations: of check and baseline together.
    freedom
        Degrees of freedom of the standard deviations.
    """
    z = np.abs(np.asarray(change, dtype=float)) / np.maximum(np.asarray(std, dtype=float), 1e-300)
    return np.asarray(2 * student_tail(z, freedom), dtype=np.float64)
