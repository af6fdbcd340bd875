"""What a health check looks at: the figures of a plane that can drift, as functions of its model.

One list serves the plan (which tones tell most of them), the comparison and the trend.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from service.identification.arrays import Real
from service.identification.loop.margins import heights, sensitivity_peaks
from service.identification.plane.model import PlaneModel
from service.identification.result.saved import SavedPlane

Kind = Literal["magnet", "frequency", "damping", "amplifier", "margin"]


@dataclass(frozen=True)
class Monitored:
    """One figure of one plane."""

    plane: str
    name: str
    """As in result.json: kiA, ksB, wn1, zeta2, sensitivity_peak_A, ..."""
    unit: str
    kind: Kind
    words: str
    """What it is, for a sentence."""

    @property
    def id(self) -> str:
        """Its name on the whole rig.

        >>> Monitored("x", "kiA", "N/A", "magnet", "").id
        'x.kiA'
        """
        return f"{self.plane}.{self.name}"


@dataclass(frozen=True)
class PlaneFigures:
    """The figures of a plane, and how they follow from a model."""

    monitored: tuple[Monitored, ...]
    of: Callable[[PlaneModel], Real]
    """Model -> (K,) values in the order of ``monitored``."""
    beside: Callable[[PlaneModel], Callable[[PlaneModel], Real]]
    """Model -> the same as a function of its neighbours, for derivatives: the peaks are not looked for anew."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Names on the whole rig."""
        return tuple(m.id for m in self.monitored)


def plane_figures(saved: SavedPlane, controller: tuple[Real, Real]) -> PlaneFigures:
    """What is monitored in a plane that was commissioned."""
    plane, orders = saved.plane, saved.model.layout.amplifier_orders
    found = [
        Monitored(plane, f"{name}{axis}", unit, "magnet", f"{words} of bearing {plane}{axis}")
        for name, unit, words in (("ki", "N/A", "force-current factor"), ("ks", "N/m", "position stiffness"))
        for axis in "AB"
    ]
    for k in range(len(saved.rotor_modes)):
        where = f"of the rotor's mode {k + 1}, plane {plane}"
        found.append(Monitored(plane, f"wn{k + 1}", "rad/s", "frequency", f"natural frequency {where}"))
        found.append(Monitored(plane, f"zeta{k + 1}", "1", "damping", f"damping ratio {where}"))
    for axis in "AB":
        where = f"of amplifier {plane}{axis}"
        found.append(Monitored(plane, f"amplifier_gain{axis}", "A/A", "amplifier", f"gain {where}"))
        found.append(Monitored(plane, f"amplifier_frequency{axis}", "rad/s", "amplifier", f"natural frequency {where}"))
    found += [
        Monitored(plane, f"sensitivity_peak_{a}", "1", "margin", f"sensitivity peak of axis {plane}{a}") for a in "AB"
    ]
    modes = np.array(saved.rotor_modes, dtype=int)

    def with_peaks(model: PlaneModel, heights_of_peaks: ArrayLike) -> Real:
        w, zeta = model.natural_frequencies[modes], model.damping_ratios[modes]
        amplifiers = [model.theta[place][:2] for place in model.layout.amplifiers]
        return np.concatenate([model.theta[:4], np.stack([w, zeta], axis=1).ravel(), *amplifiers, heights_of_peaks])

    def of(model: PlaneModel) -> Real:
        return with_peaks(model, [p.value for p in sensitivity_peaks(model, controller)])

    def beside(model: PlaneModel) -> Callable[[PlaneModel], Real]:
        peaks = sensitivity_peaks(model, controller)
        return lambda other: with_peaks(other, heights(other, controller, peaks))

    assert len(orders) == 2
    return PlaneFigures(tuple(found), of, beside)
