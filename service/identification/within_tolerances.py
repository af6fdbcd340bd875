"""A rig whose mass, geometry and sensor gains are not the datasheet's, but within its tolerances of them.

A drawing tells the mass to parts in a thousand and a sensor's place to a millimetre, a calibration its gain to a per
cent; a sweep tells the response to parts in ten thousand. Held at the datasheet's values a fit then fails on a rig that
has nothing wrong, or explains the data by a mode that no rotor has. So where it does, every plane is fitted once more
with these values free, each within its tolerance (a residual beside those of the data), then all planes together, as
the rotor is common to them (`joint.one_rotor`), and in the end each as before, with what that led to in place of the
datasheet's values.

Data cannot tell all of it: mass, inertia, ki and ks in one proportion, or a gain of all sensors and ki, are known by
tolerances alone. So the covariance of what is held goes into that of every figure (`joint.uncertainty.with_given`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.joint.one_rotor import OneRotor, one_rotor
from service.identification.plane_fit import FittedPlane
from service.identification.priors.given import Adjusted, Given
from service.identification.priors.tolerances import STRAINED, Tolerances
from sim.errors import AmbError
from sim.wording import times

SHOWN = 4
"""Values that are told in words, the farthest off."""
WRONG = (
    "so far off a value is rather wrong than loose, or something acts that the model does not have; check it, and "
    "diagnose the gap (ambit gap diagnose)"
)
FARTHEST = 10.0
"""Tolerances off beyond which a value is not taken over."""
LEFT = 0.25
"""Share of the misfit beyond the noise, in squares, that may be left where other values count as what explains it."""

Fit = Callable[[str, Tolerances | None, Given | None], FittedPlane]
"""A plane by name, with values released within their tolerances, or others held."""


@dataclass(frozen=True)
class Within:
    """Planes with what explains them within the tolerances, where anything does."""

    planes: dict[str, FittedPlane]
    rotor: OneRotor | None = None
    """What they hold in place of the datasheet's values; None: these."""
    doubts: tuple[str, ...] = ()

    @property
    def adjusted(self) -> tuple[Adjusted, ...]:
        """Every value that they hold in place of the datasheet's."""
        return () if self.rotor is None else self.rotor.adjusted


def within_tolerances(found: dict[str, FittedPlane], told: Mapping[str, Tolerances], fit: Fit) -> Within:
    """The planes as found, or where none of their models explains the data with values that do.

    Parameters
    ----------
    found
        Fitted with the datasheet's values.
    told
        What the datasheet says of each plane's (`Tolerances.of_given`).
    fit
        Fits a plane once more; raises `AmbError` where it cannot.
    """
    if not found or all(f.sound for f in found.values()):
        return Within(found)
    try:
        released = {plane: fit(plane, told[plane], None) for plane in found}
        if not _better(released, found):
            return Within(found)
        both = one_rotor({plane: (f.selected, f.data) for plane, f in released.items()}, told)
        again = {plane: fit(plane, told[plane], both.of(plane)) for plane in found}
    except AmbError:  # what is found stands
        return Within(found)
    if not _better(again, found):
        return Within(found)
    before, after = (np.sqrt(_power(planes)) for planes in (found, again))
    fall = f"residuals fall from {times(before)} to {times(after)} times the noise with"
    if all(f.adequate for f in found.values()):
        fall = "no mode that no rotor has is needed to explain the data with"
    off = sorted(both.adjusted, key=lambda a: -abs(a.off))
    strained = [a for a in off if abs(a.off) > STRAINED]
    if strained and abs(strained[0].off) > FARTHEST:
        return Within(found, doubts=(f"{fall} {_in_words(strained)} from the datasheet's value: {WRONG}",))
    doubts = [
        f"{fall} other values of mass, geometry and sensor gains than the datasheet's: the planes are identified with "
        f"these, and every deviation allows for what is not known of them ({_in_words(off[:SHOWN])})"
    ]
    if strained:
        doubts.append(f"{_in_words(strained)} from the datasheet's value: {WRONG}")
    return Within(again, both, tuple(doubts))


def _better(planes: Mapping[str, FittedPlane], before: Mapping[str, FittedPlane]) -> bool:
    """Whether other values explain what the datasheet's do not, or do without a mode that no rotor has."""
    if all(f.adequate for f in before.values()):
        return all(f.sound for f in planes.values())
    return _explain(planes, before)


def _explain(planes: Mapping[str, FittedPlane], before: Mapping[str, FittedPlane]) -> bool:
    """Whether other values explain most of what the datasheet's do not."""
    return _power(planes) - 1 < LEFT * (_power(before) - 1)


def _power(planes: Mapping[str, FittedPlane]) -> float:
    """Mean square of the residuals, 1 for noise."""
    return float(np.mean([f.residual_over_noise**2 for f in planes.values()]))


def _in_words(values: Sequence[Adjusted]) -> str:
    return ", ".join(f"{a.in_words} by {a.off:+.1f}" for a in values) + " tolerances"
