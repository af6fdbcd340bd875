"""What is fitted: a part's uncertain values and the parameters of its effects as one vector, and what is known of them.

The datasheet's values are in units of their tolerances, with a unit-normal prior; an effect's own parameters range
freely between their bounds.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground
from sim.effect import Effect, End, Parameter
from sim.effects import CATALOGUE
from sim.rig import Rig

Real = NDArray[np.float64]

TOLERANCE_BOUND = 4.0
"""A datasheet's value may be off by this many of its tolerances; what lies beyond is a gap, not an uncertainty."""
LONGEST_LOG, LONGEST = 1.5, 4.0
"""Longest step of a magnitude, in nats, and of another parameter, in units of its scale: a clearance that jumps past
the rotor's reach would not come back."""
IN_BAND = ("extra_flexible_mode", "frequency_hz")
"""An effect and its parameter that is no lower than the lowest line: to all lines a mode below them is a mass, and with
any shape at bearings and sensors as good as any mass, inertia and place of sensors together."""
BY_SPEED = frozenset({("cross_coupled_stiffness", "by_speed_ns_per_m")})
"""Dormant parameters, by effect and name, that sweeps at several speeds wake: at one they say what another one does."""
OFF_CENTRE, ECCENTRIC = "off_centre_rotor", 0.45
"""An effect, and the share of the smallest air gap that its offsets reach at most: at the pole there is no force law,
and magnets do not levitate a rotor much farther off than 0.3."""
CHANGING = ("thermal_drift",)
"""Linear effects that change while a sweep is measured, so that they are no part of the small-signal model."""


class Unknowns:
    """The vector (a + e,) of a fit: ``a`` deviations of the datasheet's values, then ``e`` parameters of effects."""

    def __init__(self, ground: Ground, effects: Sequence[Effect] = (), held: Collection[tuple[str, str]] = ()) -> None:
        """``held`` are parameters, by effect and name, that stay where their law is the plainest."""
        rig = ground.nuisance.rig
        self.ground, self.effects = ground, tuple(effect.of(rig) for effect in effects)
        self.active = ground.part.active
        other = ground.inherited
        self._held = {*held, *(() if other is None else asleep(*zip(*other.effects, strict=True)))}
        theirs = () if other is None else tuple(CATALOGUE[name].of(rig) for name, _ in other.effects)
        self._together = (*self.effects, *theirs)
        self.parameters = [(k, p) for k, e in enumerate(self._together) for p in e.parameters]
        """those of the effects, then those of inherited ones, each with the number of its effect"""
        self.n_own = sum(len(e.parameters) for e in effects)
        """number of those of the effects"""
        if other is not None:
            self.active = np.concatenate([self.active, other.active])
        """(a,) indices of the datasheet's values that are fitted"""
        self.n_nuisance = len(self.active)
        self.scale: Real = np.array([_scale(p) for _, p in self.parameters], dtype=float)
        """(e,) size of a unit of each parameter in the vector; of a magnitude, in nats"""
        ranges = [self._range(self._together[k], p) for k, p in self.parameters]
        self.low: Real = np.array([low for low, _ in ranges], dtype=float) / self.scale
        self.high: Real = np.array([high for _, high in ranges], dtype=float) / self.scale
        self._longest: Real = np.array([LONGEST_LOG if p.scale == "log" else LONGEST for _, p in self.parameters])
        self.prior, self.prior_mean = self._priors()

    def bounds(self) -> tuple[Real, Real, Real]:
        """Lowest and highest values, and the longest steps, of all unknowns, (a + e,) each."""
        bound = np.full(self.n_nuisance, TOLERANCE_BOUND)
        low, high = np.concatenate([-bound, self.low]), np.concatenate([bound, self.high])
        return low, high, np.concatenate([bound, self._longest])

    @property
    def own(self) -> list[tuple[int, Parameter]]:
        """Parameters of the part's own effects, each with the number of its effect."""
        return self.parameters[: self.n_own]

    def _range(self, effect: Effect, p: Parameter) -> tuple[float, float]:
        """Lowest and highest value that a fit gives a parameter, in the fit's own unit."""
        if (effect.id, p.name) in self._held:
            return self._inner(p, p.null), self._inner(p, p.null)
        low, high = p.low, p.high
        if (effect.id, p.name) == IN_BAND:
            low = max(low, min(float(o.frequency_hz.min()) for o in self.ground.observations))
        if effect.id == OFF_CENTRE:
            most = ECCENTRIC * float(np.min(self.ground.nuisance.rig.magnets.gap_m))
            low, high = max(low, -most), min(high, most)
        return self._inner(p, low), self._inner(p, high)

    def _priors(self) -> tuple[Real, Real]:
        """Precision, (a + e, a + e), and mean of what is known beforehand: effects of the part itself range freely."""
        a, size, other = self.n_nuisance, self.n_nuisance + len(self.scale), self.ground.inherited
        precision, centre = np.zeros((size, size)), np.zeros(size)
        precision[range(a), range(a)] = 1.0
        if other is not None:
            at = np.r_[a - len(other.active) : a, a + self.n_own : size]
            precision[np.ix_(at, at)], centre[at] = other.precision, other.mean
        return precision, centre

    @staticmethod
    def _inner(p: Parameter, value: float) -> float:
        """A parameter as the fit sees it: magnitudes over decades by their logarithm."""
        return float(np.log(np.clip(value, p.low, p.high))) if p.scale == "log" else value

    def values(self, e: Real) -> tuple[dict[str, float], ...]:
        """Effect parameters by name, one dict per effect, then per inherited one, from the scaled vector."""
        inside = np.clip(e, self.low, self.high) * self.scale
        out: list[dict[str, float]] = [{} for _ in self._together]
        for (k, p), v in zip(self.parameters, inside, strict=True):
            # of a bound, scaling back leaves what is beyond it by its last digit
            out[k][p.name] = float(np.clip(np.exp(v) if p.scale == "log" else v, p.low, p.high))
        for k, effect in enumerate(self.effects):
            out[k] |= {p.name: p.null for p in effect.parameters if (effect.id, p.name) in self._held}
        return tuple(out)

    def ends(self, e: Real) -> dict[tuple[str, str], End]:
        """Parameters, by effect and name, that a scaled vector has at an end of their range.

        Where an effect vanishes is no end.
        """
        values, near = self.values(e), 1e-9 * (self.high - self.low)
        out: dict[tuple[str, str], End] = {}
        for j, (k, p) in enumerate(self.parameters):
            if self.low[j] == self.high[j] or values[k][p.name] == p.null:
                continue
            if e[j] <= self.low[j] + near[j]:
                out[self._together[k].id, p.name] = "low"
            elif e[j] >= self.high[j] - near[j]:
                out[self._together[k].id, p.name] = "high"
        return out

    def scaled(self, values: Sequence[Mapping[str, float]]) -> Real:
        """Inverse of `values`; parameters not given keep their typical value, inherited ones what was found."""
        if self.ground.inherited is not None and len(values) < len(self._together):
            values = (*values, *(found for _, found in self.ground.inherited.effects))
        inner = [self._inner(p, values[k].get(p.name, p.typical)) for k, p in self.parameters]
        return np.asarray(np.array(inner, dtype=float) / self.scale)

    def theta(self, x: Real) -> Real:
        """All deviations, (k,): the part's own from ``x``, the others as found before."""
        theta = self.ground.theta.copy()
        theta[self.active] = x[: self.n_nuisance]
        return theta

    def build(self, x: Real) -> Rig:
        """The rig at a vector of deviations and effect parameters, (a + e,)."""
        values, n = self.values(x[self.n_nuisance :]), len(self.effects)
        rig = self.ground.rig(self.theta(x), values[n:])
        for effect, own in zip(self.effects, values[:n], strict=True):
            rig = effect.on(rig, **own)
        return rig

    def vector(self, fit: Fit) -> Real:
        """The vector (a + e,) at which a fit of this problem ended."""
        theirs = fit.inherited if len(self._together) > len(self.effects) else ()
        return np.concatenate([fit.theta[self.active], self.scaled((*fit.values, *theirs))])

    def penalty(self, x: Real) -> float:
        """What is known beforehand holds so much against a vector, chi-square, as a fit minimises it."""
        away = x - self.prior_mean
        return float(away @ self.prior @ away)

    def price(self, x: Real) -> float:
        """The same as an explanation is judged by it: of tolerances that are only assumed, less."""
        other = self.ground.inherited
        own = x[: self.n_nuisance - (0 if other is None else len(other.active))]
        return self.penalty(x) - float(own @ own) + self.ground.nuisance.price(own)


def asleep(effects: Sequence[str] = (), values: Sequence[Mapping[str, float]] = ()) -> frozenset[tuple[str, str]]:
    """Dormant parameters, by effect and name, that are at their null.

    >>> asleep(["sensor_lag"], [{"end_imbalance": 0.5}])
    frozenset({('sensor_lag', 'plane_imbalance')})
    """
    return frozenset(
        (name, p.name)
        for name, own in zip(effects, values, strict=True)
        for p in CATALOGUE[name].parameters
        if p.dormant and own.get(p.name, p.typical) == p.null
    )


def slow_to_compute(name: str) -> bool:
    """Whether an effect's force has to be evaluated in time; it is held where it hardly changes."""
    return CATALOGUE[name].nonlinear or name in CHANGING


def _scale(p: Parameter) -> float:
    """Size of one unit of an effect's parameter in the fit."""
    return 1.0 if p.scale == "log" else abs(p.typical - p.null) or abs(p.high - p.low)
