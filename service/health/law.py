"""Whether the controller that ran in a check is the one of the commissioning: u = r - C y, to the last digit.

A law that someone changed leaves rotor, magnets and amplifiers as they were, so none of their figures shows it; but
every margin is another one. Next to no noise is in u - r + C y: sensors' noise goes through the controller as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.distributions import chi2_above
from service.identification.arrays import Real
from service.identification.measured.points import PlanePoints
from service.identification.plane.zoh import discrete_response

FLOOR = 1e-3
"""Share of the largest of u, r and C y below which u - r + C y tells nothing: what starts of tones leave in it is up to
half of that, and a law that differs by less is none that anyone set."""


@dataclass(frozen=True)
class LawNow:
    """The control law of one axis in a check."""

    axis: str
    share: float
    """Size of u - r + C y as a share of the largest of the three, the root mean square over the tones."""
    differs: bool
    """Whether chance does not explain it: another law ran."""

    def document(self) -> dict[str, float | bool]:
        """As JSON."""
        return {"difference_percent": 100 * self.share, "differs": self.differs}


def law_now(points: PlanePoints, law: tuple[Real, Real], sample_time_s: float, level: float) -> tuple[LawNow, LawNow]:
    """Both axes of a plane, each by the tones that excite it.

    Parameters
    ----------
    points
        Of the check, u as the controller computed it.
    law
        Numerator and denominator from -y to u that the commissioning had.
    level
        Probability that chance alone is told to be another law.
    """
    a, b = (_axis(points, j, law, sample_time_s, level) for j in (0, 1))
    return a, b


def _axis(points: PlanePoints, j: int, law: tuple[Real, Real], sample_time_s: float, level: float) -> LawNow:
    """By Fisher's combination of the tones.

    |mean|^2 over its variance, by the scatter of B blocks, is F with 2 and 2 (B - 1) degrees of freedom; -2 log of the
    probability of as much is chi-square with 2, and its sum over the tones with twice their number.
    """
    of = points.select((points.axis == j) & ~points.suspect)
    if not len(of.omega):
        return LawNow(points.axes[j], 0.0, False)
    u, r, y = of.U[:, :, j], of.R[:, :, j], of.Y[:, :, j]
    fed_back = discrete_response(*law, of.omega, sample_time_s)[:, None] * y
    e = u - r + fed_back
    mean, freedom = e.mean(axis=1), e.shape[1] - 1
    size = np.max([np.abs(x.mean(axis=1)) for x in (u, r, fed_back)], axis=0)
    variance = np.sum(np.abs(e - mean[:, None]) ** 2, axis=1) / freedom / e.shape[1] + (FLOOR * size) ** 2
    told = 2 * freedom * np.log1p(np.abs(mean) ** 2 / variance / freedom)
    share = float(np.sqrt(np.mean(np.abs(mean / size) ** 2)))
    return LawNow(of.axes[j], share, bool(told.sum() > chi2_above(level, 2 * len(told))))
