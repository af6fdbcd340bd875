"""The loop in parts, each held against its own measured input, so that an error of one does not colour the next.

The controller is held by r - C y, the amplifiers by u, the plant by the measured coil current. Each part has its
own uncertain values and its own effects, so a mixture that spans parts is several single diagnoses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.nuisance import Nuisance
from service.gap.measured.observation import Observation
from sim.effect import Effect
from sim.effects import CATALOGUE
from sim.harmonic_balance import STATIC_HZ
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Values = Mapping[str, float]

STANDSTILL = {"modal_damping": "internal_damping"}
"""Effects that nothing tells apart on a rotor that stands still: only the first is fitted then, and both are named."""
ONE_TONE = ("amplifier_voltage_limit", "thermal_drift")
"""Effects that are not looked for in a multisine: what its lines show of them depends on all of the current's slope, or
on when each was measured."""
SIGNALS = {"controller": "u", "amplifier": "i", "plant": "y"}


@dataclass(frozen=True)
class Part:
    """A part of the loop: its output signal, the datasheet's values that act in it, the effects that may."""

    path: str
    active: NDArray[np.int64]
    """indices of the nuisance vector"""
    effects: tuple[str, ...]
    from_control: bool = False
    """The plant with the amplifiers, from u: the current was not logged."""

    @property
    def signal(self) -> str:
        """Name of the output: u, i or y."""
        return SIGNALS[self.path]


@dataclass(frozen=True)
class Inherited:
    """What the fit of another part leaves uncertain, normal about what it found: it is fitted here too.

    Held at what noisy currents made of it, a delay of the amplifiers that they hardly showed came back as a lag of the
    plant, which is measured much better.
    """

    of: tuple[str, ...]
    """effects of that part's explanation"""
    active: NDArray[np.int64]
    """(a,) indices of the nuisance vector"""
    effects: tuple[tuple[str, Values], ...]
    """those whose parameters, e in all, are uncertain too"""
    mean: Real
    """(a + e,) deviations and effect parameters, in the units of the fit"""
    precision: Real
    """(a + e, a + e) inverse of their covariance"""


@dataclass(frozen=True)
class Ground:
    """What every fit of a part shares: data, the values that other parts fixed, and the effects found there."""

    nuisance: Nuisance
    part: Part
    observations: tuple[Observation, ...]
    theta: Real
    """(k,) deviations of all values; only the part's own are fitted"""
    found: tuple[tuple[str, Values], ...] = ()
    """effects of other parts"""
    from_current: bool = False
    """The plant is driven by the measured current: no amplifier explains how it came to be."""
    inherited: Inherited | None = None
    """what is uncertain of another part; its effects are not among ``found``"""

    def rig(self, theta: Real, inherited: Sequence[Values] | None = None) -> Rig:
        """The rig at deviations ``theta`` with what other parts have found.

        ``inherited`` are the parameters of the uncertain ones among their effects, by default as they were found.
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
        """The rig at a fit's deviations, which may be of before another part was explained anew.

        Its own deviations count and, where this ground has any, what it made of the uncertain part of another one
        (``inherited``, as of `Fit`); all else is as other parts have it now.
        """
        uncertain = self.inherited
        of = self.part.active if uncertain is None else np.concatenate([self.part.active, uncertain.active])
        now = self.theta.copy()
        now[of] = theta[of]
        return self.rig(now, inherited if uncertain is not None and inherited else None)


def possible(nuisance: Nuisance, observations: Sequence[Observation], paths: Sequence[str]) -> list[Effect]:
    """Effects of some paths that this rig and these conditions could show, one of each exact alias."""
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
        and not (together and e.id in ONE_TONE)
    ]


def parts(nuisance: Nuisance, observations: Sequence[Observation]) -> list[Part]:
    """The parts of the loop that the log tells apart, in the order in which they are to be looked at."""

    def part(path: str, of: NDArray[np.bool_], paths: Sequence[str], from_control: bool = False) -> Part:
        names = tuple(e.id for e in possible(nuisance, observations, paths))
        return Part(path, np.flatnonzero(of), names, from_control)

    amplifier = np.array([name.startswith("amplifier") for name in nuisance.names])
    controller = part("controller", np.zeros_like(amplifier), ("controller",))
    if any(o.I is None for o in observations):
        return [controller, part("plant", np.ones_like(amplifier), ("amplifier", "plant"), from_control=True)]
    return [controller, part("amplifier", amplifier, ("amplifier",)), part("plant", ~amplifier, ("plant",))]


def driven_by_current(rig: Rig, o: Observation) -> Observation:
    """The observation with the control signal that would have made the measured current, and noise to match.

    Fitting y to it is fitting the plant alone, whatever the amplifiers do; the current's own noise then counts, so
    where the amplifiers are understood it is better to let them answer to u, which has none.
    """
    assert o.I is not None
    U, sd_y = o.U.copy(), o.sd_y.copy()
    for k, h in enumerate(o.harmonics):
        model = linear_model(rig, np.maximum(h * o.frequency_hz, STATIC_HZ))
        U[:, k] = np.linalg.solve(model.i_per_u[o.line], o.I[:, k, :, None])[..., 0]
        spread = np.abs(model.y_per_i[o.line]) ** 2 @ (o.sd_i[:, k, :, None] ** 2)
        sd_y[:, k] = np.sqrt(o.sd_y[:, k] ** 2 + spread[..., 0])
    return replace(o, U=U, sd_y=sd_y)
