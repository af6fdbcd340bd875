"""The one shape of an effect: a small function from rig to rig, with its parameters and its words.

An effect names itself and the path of the loop where it acts, describes each parameter with unit, range
and prior, and returns a rig with a part added or changed. Both the time simulation and the
frequency-domain model are built from that rig, so an effect is written once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from sim.errors import EffectError
from sim.rig import Rig
from sim.sizes import Size
from sim.wording import in_words

Path = Literal["controller", "amplifier", "plant", "additive"]
End = Literal["low", "high"]
"""Of a range."""
SUFFIXES = {
    "s": "_s",
    "m": "_m",
    "A": "_a",
    "Hz": "_hz",
    "rad": "_rad",
    "rad/s": "_rad_s",
    "N/m": "_n_per_m",
    "s/A": "_s_per_a",
    "1/A": "_per_a",
    "1/kg": "_per_kg",
    "1/sqrt(kg)": "_per_sqrt_kg",
    "1/(m sqrt(kg))": "_per_m_sqrt_kg",
    "kg m2": "_kgm2",
    "N s/m": "_ns_per_m",
}
"""Suffix of a parameter's name, by its unit."""
MARGIN = 5.0
"""Factor by which a rig's parameter may exceed a range that scales with a size of the rig, as a fit may have changed
that size by so much: a stiffness by four of its tolerances."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    ``null`` is the value at which the effect vanishes; ``low`` and ``high`` bound what is physically
    plausible; ``typical`` is a plainly visible strength. ``scale`` says how a prior spreads over the range:
    logarithmically for magnitudes over decades, linearly otherwise.
    """

    name: str
    unit: str
    low: float
    high: float
    typical: float
    null: float
    scale: Literal["log", "linear"] = "linear"
    description: str = ""
    strength: bool = True
    """False for a parameter that shapes the effect without making it vanish (a resonance's frequency)."""
    amount: bool = False
    """True for one that is an amount all the same, of which axes that differ have different shares."""
    optional: bool = False
    """True where the law is simpler with it at ``null``: it is reported there unless the data contradict."""
    dormant: bool = False
    """True where it is needed by few rigs: a fit that starts with it at ``null`` holds it there."""
    wakes: tuple[float, ...] = ()
    """Of a dormant one, starts of the fits in which it is free, once the effect without it leaves too much; empty where
    something else decides on that."""
    needs: Callable[[Rig], bool] | None = None
    """Whether a rig has the part that it acts on. On others it does nothing: the effect does without it (`Effect.of`),
    or where the law's others are stated with it, as dormant ones are, it never wakes."""
    goes_with: Size | None = None
    """The size of a rig with which the range scales; None where it is the same on every rig. The range is stated for
    the reference rig."""

    def of(self, rig: Rig) -> Parameter:
        """The parameter with its range scaled to a rig; asleep where the rig has nothing that it shapes."""
        if self.needs is not None and not self.needs(rig):
            return replace(self, wakes=(), needs=None).of(rig)
        if self.goes_with is None:
            return self
        by = self.goes_with.ratio(rig)
        own = replace(self.goes_with, reference=self.goes_with.of(rig))
        low, high, typical, null = (by * v for v in (self.low, self.high, self.typical, self.null))
        wakes = tuple(by * v for v in self.wakes)
        return replace(self, low=low, high=high, typical=typical, null=null, wakes=wakes, goes_with=own)

    def allows(self, value: float) -> bool:
        """Whether a rig may have a value: in its range, or up to `MARGIN` times a range that scales with a size."""
        beyond = 1.0 if self.goes_with is None else MARGIN
        lowest = self.low * beyond if self.low < 0 else self.low / beyond
        return min(lowest, self.null) <= value <= max(self.high * beyond, self.null)

    @property
    def words(self) -> str:
        """The name in words, without its unit."""
        return in_words(self.name.removesuffix(SUFFIXES.get(self.unit, "")))


def rarely_needed(
    name: str,
    unit: str,
    low: float,
    high: float,
    null: float,
    scale: Literal["log", "linear"] = "linear",
    description: str = "",
    *,
    amount: bool = False,
    wakes: tuple[float, ...] = (),
    needs: Callable[[Rig], bool] | None = None,
    goes_with: Size | None = None,
) -> Parameter:
    """A parameter that shapes an effect on few rigs: fits hold it at ``null`` until the law without it leaves too much.

    Arguments as of `Parameter`.
    """
    return Parameter(
        name,
        unit,
        low,
        high,
        null,
        null,
        scale,
        description,
        strength=False,
        amount=amount,
        optional=True,
        dormant=True,
        wakes=wakes,
        needs=needs,
        goes_with=goes_with,
    )


def has_axis(axis: str, rig: Rig) -> bool:
    """Whether a rig has an axis: what a parameter of it needs."""
    return axis in rig.axes


def has_modes(rig: Rig, number: int) -> bool:
    """Whether each plane of a rig has that many flexible modes: what a parameter of the last of them needs."""
    return min(map(len, rig.rotor.modes)) >= number


def has_two_planes(rig: Rig) -> bool:
    """Whether a rig has both planes: what a parameter that joins them needs."""
    return rig.n_planes > 1


@dataclass(frozen=True)
class Effect:
    """An unmodelled effect that a twin can lack."""

    id: str
    path: Path
    parameters: tuple[Parameter, ...]
    apply: Callable[[Rig, Mapping[str, float]], Rig]
    """(rig, values by name) -> rig with the effect."""
    law: str
    signature: str
    aliases: tuple[str, ...]
    """Ids of effects that look alike."""
    separated_by: str
    source: str
    needs_axes: int = 2
    needs_speed: bool = False
    nonlinear: bool = False
    """True when the response is not proportional to the excitation."""
    absent: Mapping[str, float] = field(default_factory=dict)
    """Values with which ``apply`` is called of parameters that a rig has not: those at which they do nothing."""
    restated: Callable[[Mapping[str, float], Mapping[str, float]], Mapping[str, float]] = lambda values, like: values
    """(values, like) -> the same effect as ``values``, with redundant parameters (as the sign of a mode shape, the time
    over which a drift is stated) chosen as in ``like``, so that both can be compared."""
    likened: Mapping[str, Callable[[Mapping[str, float]], Sequence[Mapping[str, float]]]] = field(default_factory=dict)
    """By id of an alias: the alias's values -> those with which this effect is most like it, several where that leaves
    open what the alias does not have; none where it cannot be."""
    includes: Mapping[str, Callable[[Mapping[str, float], Mapping[str, float]], Mapping[str, float]]] = field(
        default_factory=dict
    )
    """By id of another effect: (own values, the other's) -> those with which this effect alone is most like both; empty
    where it cannot be."""

    def on(self, rig: Rig, **values: float) -> Rig:
        """Rig with this effect; parameters not given keep their typical value.

        Raises
        ------
        EffectError
            An unknown parameter, one out of its range, or a rig with too few axes.
        """
        known = {p.name: p.of(rig) for p in self.parameters}
        for name, value in values.items():
            if name not in known:
                raise EffectError(f"effect {self.id} has no parameter {name!r}; it has {', '.join(known)}")
            p = known[name]
            if not p.allows(value):
                raise EffectError(f"{self.id}.{name} = {value} {p.unit} is outside {p.low:g} to {p.high:g} {p.unit}")
        if rig.n_axes < self.needs_axes:
            raise EffectError(f"effect {self.id} needs {self.needs_axes} axes; rig {rig.name} has {rig.n_axes}")
        return self.apply(rig, {**self.absent, **{name: values.get(name, p.typical) for name, p in known.items()}})

    def of(self, rig: Rig) -> Effect:
        """The effect with its ranges scaled to a rig, without parameters of axes and modes that the rig has not."""
        absent = {p.name: p.null for p in self.parameters if not p.dormant and p.needs is not None and not p.needs(rig)}
        used = tuple(p.of(rig) for p in self.parameters if p.name not in absent)
        return replace(self, parameters=used, absent={**self.absent, **absent})

    def null(self) -> dict[str, float]:
        """Parameter values at which the effect vanishes; shape parameters stay typical."""
        return {p.name: p.null if p.strength else p.typical for p in self.parameters}
