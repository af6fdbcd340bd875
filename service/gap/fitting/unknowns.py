"""The vector of unknowns of a fit: a part's nuisance values and its effects' parameters, with bounds and priors.

The datasheet's values are in units of their tolerances, with a unit-normal prior; an effect's own parameters range
freely between their bounds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground
from sim.effect import Effect, End, Parameter
from sim.effects import CATALOGUE
from sim.rig import Rig

Real = NDArray[np.float64]

TOLERANCE_BOUND = 4.0
"""Bound of a nuisance value, in tolerances; what lies beyond is a gap, not an uncertainty."""
LONGEST_LOG, LONGEST = 1.5, 4.0
"""Longest step of a parameter with a log scale, in nats, and of another one, in units of its scale: a clearance that
jumps past the rotor's reach has no derivative there and would not come back."""
IN_BAND = ("extra_flexible_mode", "frequency_hz")
"""An effect's parameter that is bounded by the lowest line: a mode below all lines acts as a mass, and with any shapes
at bearings and sensors can imitate any mass, inertia and sensor positions together."""
BY_SPEED = frozenset({("cross_coupled_stiffness", "by_speed_ns_per_m")})
"""Dormant (effect, parameter) that are fitted where sweeps are at several speeds: at one speed they are aliases of
another parameter."""
TURNING = frozenset({("cross_coupled_stiffness", "inverse_whirl_ratio")})
"""Dormant (effect, parameter) that act on a rotor that turns alone."""
OFF_CENTRE, ECCENTRIC = "off_centre_rotor", 0.45
"""An effect, and the bound of its offsets as a share of the smallest air gap: at the pole face the force law is
singular, and magnets do not levitate a rotor much farther off than 0.3."""
CHANGING = ("thermal_drift",)
"""Linear effects that change while a sweep is measured, so that they are not in the small-signal model."""


class Unknowns:
    """The vector (a + e,) of a fit: ``a`` nuisance values, then ``e`` parameters of effects.

    Nuisance values are the part's own, then inherited ones; effects are those to be fitted, then inherited ones.
    """

    def __init__(
        self,
        ground: Ground,
        effects: Sequence[Effect] = (),
        held: Collection[tuple[str, str]] = (),
        found: Sequence[Mapping[str, float]] = (),
    ) -> None:
        """``held`` are parameters, (effect, name), that are held at their null, where the law is the simplest.

        ``found`` are values of the effects, of other lines perhaps: they are in range whatever the lines of this ground
        are.
        """
        rig = ground.nuisance.rig
        self._found = found
        self.ground, self.effects = ground, tuple(effect.of(rig) for effect in effects)
        self.active = ground.part.active
        other = ground.inherited
        self._held = {*held, *(() if other is None else dormant_at_null(*zip(*other.effects, strict=True)))}
        inherited = () if other is None else tuple(CATALOGUE[name].of(rig) for name, _ in other.effects)
        self._all_effects = (*self.effects, *inherited)
        self.parameters = [(k, p) for k, e in enumerate(self._all_effects) for p in e.parameters]
        """(number of the effect, parameter), of the effects to be fitted, then of inherited ones"""
        self.n_own = sum(len(e.parameters) for e in self.effects)
        """number of parameters of the effects to be fitted"""
        self.slow = [slow_to_compute(self._all_effects[k].id) for k, _ in self.parameters]
        """whether each parameter is of an effect that is evaluated in the time domain"""
        if other is not None:
            self.active = np.concatenate([self.active, other.active])
        """(a,) indices of the nuisance values that are fitted"""
        self.n_nuisance = len(self.active)
        self._logarithmic = np.array([p.scale == "log" for _, p in self.parameters], dtype=bool)
        self._ranges = tuple(np.array([getattr(p, end) for _, p in self.parameters]) for end in ("low", "high"))
        self.scale: Real = np.array([_scale(p) for _, p in self.parameters], dtype=float)
        """(e,) size of a unit of each parameter in the vector; with a log scale, in nats"""
        ranges = [self._range(k, p) for k, p in self.parameters]
        self.low: Real = np.array([low for low, _ in ranges], dtype=float) / self.scale
        self.high: Real = np.array([high for _, high in ranges], dtype=float) / self.scale
        self._longest: Real = np.array([LONGEST_LOG if p.scale == "log" else LONGEST for _, p in self.parameters])
        self.prior, self.prior_mean = self._priors()
        self._without_own: tuple[bytes, Rig] | None = None
        """contents of the last vector but for the effects' own parameters, and its rig without them"""

    def bounds(self) -> tuple[Real, Real, Real]:
        """Lowest and highest values, and the longest steps, of all unknowns, (a + e,) each."""
        bound = np.full(self.n_nuisance, TOLERANCE_BOUND)
        low, high = np.concatenate([-bound, self.low]), np.concatenate([bound, self.high])
        return low, high, np.concatenate([bound, self._longest])

    @property
    def own(self) -> list[tuple[int, Parameter]]:
        """(number of the effect, parameter) of the effects to be fitted, without inherited ones."""
        return self.parameters[: self.n_own]

    def _range(self, k: int, p: Parameter) -> tuple[float, float]:
        """Bounds of a parameter of effect ``k`` in the fit, logarithmic with a log scale."""
        effect = self._all_effects[k]
        if (effect.id, p.name) in self._held:
            return self._internal(p, p.null), self._internal(p, p.null)
        low, high = p.low, p.high
        if (effect.id, p.name) == IN_BAND:
            lowest = min(float(o.frequency_hz.min()) for o in self.ground.observations)
            known = self._found[k].get(p.name, lowest) if k < len(self._found) else lowest
            low = max(low, min(lowest, known))
        if effect.id == OFF_CENTRE:
            most = ECCENTRIC * float(np.min(self.ground.nuisance.rig.magnets.gap_m))
            low, high = max(low, -most), min(high, most)
        return self._internal(p, low), self._internal(p, high)

    def _priors(self) -> tuple[Real, Real]:
        """Precision, (a + e, a + e), and mean of the normal priors; zero for effects to be fitted: no prior."""
        a, size, other = self.n_nuisance, self.n_nuisance + len(self.scale), self.ground.inherited
        precision, centre = np.zeros((size, size)), np.zeros(size)
        precision[range(a), range(a)] = 1.0
        if other is not None:
            at = np.r_[a - len(other.active) : a, a + self.n_own : size]
            precision[np.ix_(at, at)], centre[at] = other.precision, other.mean
        return precision, centre

    @staticmethod
    def _internal(p: Parameter, value: float) -> float:
        """A parameter as the fit has it: its logarithm with a log scale."""
        return float(np.log(np.clip(value, p.low, p.high))) if p.scale == "log" else value

    def values(self, e: Real) -> tuple[dict[str, float], ...]:
        """Parameters by name, one dict per effect and then per inherited one, from their part (e,) of the vector."""
        inside = np.clip(e, self.low, self.high) * self.scale
        np.exp(inside, out=inside, where=self._logarithmic)
        # clipped again, as rounding may put a value at its bound just beyond it
        inside = np.clip(inside, *self._ranges)
        out: list[dict[str, float]] = [{} for _ in self._all_effects]
        for (k, p), v in zip(self.parameters, inside.tolist(), strict=True):
            out[k][p.name] = v
        for k, effect in enumerate(self.effects):
            out[k] |= {p.name: p.null for p in effect.parameters if (effect.id, p.name) in self._held}
        return tuple(out)

    def ends(self, e: Real) -> dict[tuple[str, str], End]:
        """(effect, parameter) that are at an end of their range, from their part (e,) of the vector.

        The null, where an effect vanishes or its law is the simplest, does not count as an end.
        """
        values, near = self.values(e), 1e-9 * (self.high - self.low)
        out: dict[tuple[str, str], End] = {}
        for j, (k, p) in enumerate(self.parameters):
            if self.low[j] == self.high[j] or values[k][p.name] == p.null:
                continue
            if e[j] <= self.low[j] + near[j]:
                out[self._all_effects[k].id, p.name] = "low"
            elif e[j] >= self.high[j] - near[j]:
                out[self._all_effects[k].id, p.name] = "high"
        return out

    def scaled(self, values: Sequence[Mapping[str, float]]) -> Real:
        """Inverse of `values`; parameters not given have their typical value, inherited effects the values found."""
        if self.ground.inherited is not None and len(values) < len(self._all_effects):
            values = (*values, *(found for _, found in self.ground.inherited.effects))
        internal = [self._internal(p, values[k].get(p.name, p.typical)) for k, p in self.parameters]
        return np.asarray(np.array(internal, dtype=float) / self.scale)

    def theta(self, x: Real) -> Real:
        """The whole nuisance vector, (k,): values that are fitted from ``x``, the others as other parts have them."""
        theta = self.ground.theta.copy()
        theta[self.active] = x[: self.n_nuisance]
        return theta

    def build(self, x: Real) -> Rig:
        """The rig at a vector of deviations and effect parameters, (a + e,)."""
        values, n = self.values(x[self.n_nuisance :]), len(self.effects)
        # derivatives move the effects' own parameters alone, one after another
        without = np.delete(x, slice(self.n_nuisance, self.n_nuisance + self.n_own)).tobytes()
        if self._without_own is None or self._without_own[0] != without:
            self._without_own = without, self.ground.rig(self.theta(x), values[n:])
        rig = self._without_own[1]
        for effect, own in zip(self.effects, values[:n], strict=True):
            rig = effect.on(rig, **own)
        return rig

    def vector(self, fit: Fit) -> Real:
        """The vector (a + e,) at which a fit of this problem ended."""
        inherited = fit.inherited if len(self._all_effects) > len(self.effects) else ()
        return np.concatenate([fit.theta[self.active], self.scaled((*fit.values, *inherited))])

    def penalty(self, x: Real) -> float:
        """Penalty of the normal priors, a chi-square, as a fit minimises it."""
        away = x - self.prior_mean
        return float(away @ self.prior @ away)

    def price(self, x: Real) -> float:
        """Penalty by which an explanation is judged: less than `penalty` where tolerances are only assumed."""
        other = self.ground.inherited
        own = x[: self.n_nuisance - (0 if other is None else len(other.active))]
        return self.penalty(x) - float(own @ own) + self.ground.nuisance.price(own)


def dormant_at_null(
    effects: Sequence[str] = (), values: Sequence[Mapping[str, float]] = ()
) -> frozenset[tuple[str, str]]:
    """Dormant (effect, parameter) that are at their null, so that a fit holds them there.

    >>> sleeping = dormant_at_null(["sensor_lag"], [{"end_imbalance": 0.5}])
    >>> ("sensor_lag", "plane_imbalance") in sleeping, ("sensor_lag", "end_imbalance") in sleeping
    (True, False)
    """
    return frozenset(
        (name, p.name)
        for name, own in zip(effects, values, strict=True)
        for p in CATALOGUE[name].parameters
        if p.dormant and own.get(p.name, p.typical) == p.null
    )


def slow_to_compute(name: str) -> bool:
    """Whether an effect is evaluated in the time domain, which is slow: nonlinear, or changing during a sweep."""
    return CATALOGUE[name].nonlinear or name in CHANGING


def slow_first(names: Iterable[str]) -> list[str]:
    """Effects in the order in which fits of them are begun, so that no process waits for a last long one.

    >>> slow_first(["sensor_lag", "magnetic_hysteresis"])
    ['magnetic_hysteresis', 'sensor_lag']
    """
    return sorted(names, key=lambda name: not slow_to_compute(name))


def _scale(p: Parameter) -> float:
    """Size of one unit of an effect's parameter in the vector."""
    return 1.0 if p.scale == "log" else abs(p.typical - p.null) or abs(p.high - p.low)
