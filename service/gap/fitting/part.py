"""The parts of the loop, each predicted from its own measured input, so that an error of one does not bias the next.

The controller predicts u from r and y, the amplifiers i from u, the plant y from i. Each part has its own uncertain
values and its own effects, so a mixture that spans parts is several single diagnoses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.plant_input import LawError, driven_by_current
from service.gap.measured.observation import Observation
from sim.effect import Effect
from sim.effects import CATALOGUE
from sim.rig import Rig

Real = NDArray[np.float64]
Values = Mapping[str, float]

STANDSTILL = {"modal_damping": "internal_damping"}
"""Exact aliases on a rotor at standstill: only the first is fitted then, and both are named."""
STEPPED_SINE_ONLY = ("amplifier_voltage_limit", "thermal_drift")
"""Effects that are not searched for in a multisine: their response at a line depends on the current's slope in all
lines, or on when each line was measured."""
SIGNALS = {"controller": "u", "amplifier": "i", "plant": "y"}


@dataclass(frozen=True)
class Part:
    """A part of the loop: its output signal, the nuisance values that act in it, the effects that may."""

    path: str
    active: NDArray[np.int64]
    """indices of the nuisance vector"""
    effects: tuple[str, ...]
    from_control: bool = False
    """whether this is amplifiers and plant in one, from u to y, as the current was not logged"""

    @property
    def signal(self) -> str:
        """Name of the output: u, i or y."""
        return SIGNALS[self.path]


@dataclass(frozen=True)
class Inherited:
    """Normal posterior of another part's fit, the prior of its values, which are fitted again in this part.

    If the amplifiers were held at their own fit, a delay that their noisy currents hardly show would reappear as a lag
    of the plant, which is measured much better.
    """

    of: tuple[str, ...]
    """effects of that part's explanation"""
    active: NDArray[np.int64]
    """(a,) indices of the nuisance vector"""
    effects: tuple[tuple[str, Values], ...]
    """those of them whose parameters, e in all, are fitted again; by name, with the values found"""
    mean: Real
    """(a + e,) deviations and effect parameters, in the units of the fit"""
    precision: Real
    """(a + e, a + e) inverse of their covariance"""


@dataclass(frozen=True)
class Ground:
    """What all fits of a part have in common: its data, and what the fits of other parts found."""

    nuisance: Nuisance
    part: Part
    observations: tuple[Observation, ...]
    theta: Real
    """(k,) deviations of all values; only the part's own are fitted"""
    found: tuple[tuple[str, Values], ...] = ()
    """effects of other parts, held at these values"""
    from_current: bool = False
    """whether the plant is driven by the measured current, as no model of the amplifiers predicts it"""
    inherited: Inherited | None = None
    """another part's values that are fitted again; its effects are not among ``found``"""
    law_error: LawError | None = None
    """how far the amplifiers' effects may miss the current that drives the plant"""

    def as_input(self, o: Observation) -> Observation:
        """A sweep as fits of this part take it, with what drives the part and how well that is known."""
        if self.from_current:
            return driven_by_current(self.rig(self.theta), o)
        return o if self.law_error is None else self.law_error.on(o)

    def rig(self, theta: Real, inherited: Sequence[Values] | None = None) -> Rig:
        """The rig at deviations ``theta`` with the effects of other parts.

        ``inherited`` are the parameters of inherited effects, by default those found.
        """
        rig = self.nuisance.at(theta)
        uncertain = () if self.inherited is None else self.inherited.effects
        moved = [values for _, values in uncertain] if inherited is None else inherited
        for name, values in (*self.found, *((n, v) for (n, _), v in zip(uncertain, moved, strict=True))):
            rig = CATALOGUE[name].on(rig, **values)
        if self.from_current:  # the amplifiers' own limits are in that current already
            free = np.full(rig.n_axes, np.inf)
            rig = replace(rig, amplifiers=replace(rig.amplifiers, slew_limit_a_per_s=free))
        return rig

    def fitted_rig(self, theta: Real, inherited: Sequence[Values]) -> Rig:
        """The rig of a fit of this part, which may be older than the present fits of other parts.

        Of ``theta`` the part's own deviations count, and inherited ones where this ground has any, with ``inherited``
        as of `Fit`; all else is as other parts have it now.
        """
        uncertain = self.inherited
        fitted = self.part.active if uncertain is None else np.concatenate([self.part.active, uncertain.active])
        now = self.theta.copy()
        now[fitted] = theta[fitted]
        return self.rig(now, inherited if uncertain is not None and inherited else None)


def possible(nuisance: Nuisance, observations: Sequence[Observation], paths: Sequence[str]) -> list[Effect]:
    """Effects of some paths that could show on this rig in these sweeps, one of each pair of exact aliases."""
    turning = any(o.speed_rad_s for o in observations)
    together = any(o.together for o in observations)
    return [
        e
        for e in CATALOGUE.values()
        if e.path in paths
        and e.needs_axes <= nuisance.rig.n_axes
        and (turning or not e.needs_speed)
        and (nuisance.n_modes or e.id not in ("modal_damping", "internal_damping"))
        and (turning or e.id not in STANDSTILL.values())
        and not (together and e.id in STEPPED_SINE_ONLY)
    ]


def parts(nuisance: Nuisance, observations: Sequence[Observation]) -> list[Part]:
    """The parts of the loop that the logged signals separate, in the order in which they are explained."""

    def part(path: str, of: NDArray[np.bool_], paths: Sequence[str], from_control: bool = False) -> Part:
        names = tuple(e.id for e in possible(nuisance, observations, paths))
        return Part(path, np.flatnonzero(of), names, from_control)

    amplifier = np.array([name.startswith("amplifier") for name in nuisance.names])
    controller = part("controller", np.zeros_like(amplifier), ("controller",))
    if any(o.I is None for o in observations):
        return [controller, part("plant", np.ones_like(amplifier), ("amplifier", "plant"), from_control=True)]
    return [controller, part("amplifier", amplifier, ("amplifier",)), part("plant", ~amplifier, ("plant",))]
