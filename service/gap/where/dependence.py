"""Whether the gap depends on amplitude or speed: two sweeps at different conditions are compared."""

from __future__ import annotations

from dataclasses import dataclass

from service.gap.measured.condition import conditions_of
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import SIGNIFICANT
from service.gap.which.between_sweeps import change_between
from service.gap.which.explained import Explained


@dataclass(frozen=True)
class Dependence:
    """Whether the gap depends on a condition; None where these data do not test it."""

    amplitude: bool | None = None
    speed: bool | None = None
    significance: float | None = None
    """significance of the change between the two sweeps, a normal deviate; None where they are at one condition"""


def dependence(e: Explained, other: Observation, distorted: bool) -> Dependence:
    """Whether a part's gap depends on amplitude and speed.

    Parameters
    ----------
    e
        The part, with the plain twin's residuals on the main sweep.
    other
        The whole other sweep.
    distorted
        Whether a nonlinearity is proven at one amplitude already: by harmonics, or by a nonlinear effect.
    """
    amplitude, speed = conditions_of(e.ground.observations[0], other)
    change = change_between(e, other) if amplitude or speed else None
    differs = change is not None and change > SIGNIFICANT
    if amplitude and speed and differs:  # one of them, or both
        return Dependence(distorted or None, None, change)
    return Dependence(distorted or (differs if amplitude else None), differs if speed else None, change)
