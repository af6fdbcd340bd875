"""Laws that the catalogue does not hold, only ever withheld: the diagnosis must say "none of these".

Some change the rig (`Rig` to `Rig`), the others stand between the rig and whoever measures it: what they do to the
excitation before it reaches the loop, and to the records before they are logged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

from sim.errors import EffectError
from sim.rig import Array, FlexibleMode, Rig
from sim.stepping import Record, Simulation

Generator = np.random.Generator


class Tampering:
    """Nothing, to begin with: r as asked for, the log as it is."""

    def excite(self, r: Array) -> Array:
        """What is really added to the control signal, (N, n_axes)."""
        return r

    def log(self, record: Record, share: float) -> Record:
        """What is logged; ``share`` of the campaign has passed."""
        return record


class TamperedSimulation(Simulation):
    """A rig whose measurement lies by some law.

    Parameters
    ----------
    campaign_s
        Rig time that the campaign is expected to take, for laws that set in on the way.
    """

    def __init__(self, rig: Rig, seed: int, law: Tampering, campaign_s: float) -> None:
        super().__init__(rig, seed)
        self._tampering, self._campaign_s = law, campaign_s

    def advance(self, r: Array, check_limits: bool = True) -> Record:
        """As `Simulation.advance`, through the law."""
        excited = self._tampering.excite(r)
        record = super().advance(excited, check_limits)
        logged = self._tampering.log(record, self.time_s / self._campaign_s)
        if excited is r:
            return logged
        return replace(logged, r=np.ascontiguousarray(r[: len(record)], dtype=float))  # as it was commanded


@dataclass
class ClippedLog(Tampering):
    """Logged displacement saturates; the loop's own does not."""

    limit_m: float

    def log(self, record: Record, share: float) -> Record:
        """Record with y clipped."""
        return replace(record, y=np.clip(record.y, -self.limit_m, self.limit_m))


@dataclass
class HeldLog(Tampering):
    """Every k-th logged displacement is lost and the one before stands in its place."""

    every: int
    _samples: int = 0
    _last: Array | None = None

    def log(self, record: Record, share: float) -> Record:
        """Record with y held where a sample was lost."""
        before = record.y[:1] if self._last is None else self._last
        shifted = np.concatenate([before, record.y[:-1]])
        lost = (self._samples + np.arange(len(record))) % self.every == self.every - 1
        self._samples += len(record)
        self._last = record.y[-1:]
        return replace(record, y=np.where(lost[:, None], shifted, record.y))


@dataclass
class CoarseLog(Tampering):
    """The logger keeps too few bits of the displacement."""

    step_m: float

    def log(self, record: Record, share: float) -> Record:
        """Record with y in steps."""
        return replace(record, y=self.step_m * np.round(record.y / self.step_m))


@dataclass
class FilteredLog(Tampering):
    """A first-order filter before the logger, on one signal of some axes; the loop does not see it."""

    signal: str
    """"i" or "y"."""
    axes: tuple[int, ...]
    corner_hz: float
    sample_time_s: float
    _state: dict[int, Array] = field(default_factory=dict)

    def log(self, record: Record, share: float) -> Record:
        """Record with the signal filtered."""
        x = np.array(getattr(record, self.signal))
        forget = math.exp(-2 * math.pi * self.corner_hz * self.sample_time_s)
        for axis in self.axes:
            state = self._state.get(axis, np.array([forget * x[0, axis]]))
            x[:, axis], self._state[axis] = lfilter([1 - forget], [1.0, -forget], x[:, axis], zi=state)
        return replace(record, i=x) if self.signal == "i" else replace(record, y=x)


@dataclass
class LooseConnector(Tampering):
    """The logged gain of one displacement changes while the campaign runs."""

    axis: int
    change: float
    from_share: float

    def log(self, record: Record, share: float) -> Record:
        """Record with the axis scaled, once it is loose."""
        if share < self.from_share:
            return record
        y = record.y.copy()
        y[:, self.axis] *= 1 + self.change
        return replace(record, y=y)


@dataclass
class CurvedProbe(Tampering):
    """Current probes with a cubic error in the log."""

    cubic_per_a2: float

    def log(self, record: Record, share: float) -> Record:
        """Record with i bent."""
        return replace(record, i=record.i + self.cubic_per_a2 * record.i**3)


@dataclass
class WrongInjection(Tampering):
    """The excitation is injected with a gain that is not 1 and grows with its size; the log says what was asked for."""

    gain_change: float
    cubic_per_a2: float

    def excite(self, r: Array) -> Array:
        """Excitation as it is really added."""
        return (1 + self.gain_change) * r + self.cubic_per_a2 * r**3


@dataclass(frozen=True)
class Drawn:
    """A law on a rig: the rig, what stands between it and the log, and the law's numbers."""

    rig: Rig
    tampering: Tampering
    parameters: dict[str, float]


def _size(g: Generator, low: float, high: float) -> float:
    """Between low and high, logarithmically."""
    return float(low * (high / low) ** g.uniform())


def _sign(g: Generator) -> float:
    return float(g.choice([-1.0, 1.0]))


def _clipped_log(rig: Rig, g: Generator) -> Drawn:
    limit = _size(g, 1.5e-6, 6e-6)
    return Drawn(rig, ClippedLog(limit), {"limit_m": limit})


def _held_log(rig: Rig, g: Generator) -> Drawn:
    every = int(g.choice([3, 5, 9, 17]))
    return Drawn(rig, HeldLog(every), {"every": every})


def _coarse_log(rig: Rig, g: Generator) -> Drawn:
    step = _size(g, 0.3e-6, 2e-6)
    return Drawn(rig, CoarseLog(step), {"step_m": step})


def _coarse_sensor(rig: Rig, g: Generator) -> Drawn:
    step = _size(g, 0.3e-6, 1.5e-6)
    noise = replace(rig.noise, displacement_step_m=step)
    return Drawn(replace(rig, noise=noise), Tampering(), {"step_m": step})


def _filtered_current_log(rig: Rig, g: Generator) -> Drawn:
    hz = _size(g, 500.0, 8e3)
    law = FilteredLog("i", tuple(range(rig.n_axes)), hz, rig.controller.sample_time_s)
    return Drawn(rig, law, {"corner_hz": hz})


def _filtered_displacement_log(rig: Rig, g: Generator) -> Drawn:
    hz, axis = _size(g, 500.0, 8e3), int(g.integers(rig.n_axes))
    return Drawn(
        rig, FilteredLog("y", (axis,), hz, rig.controller.sample_time_s), {"corner_hz": hz, "axis": float(axis)}
    )


def _loose_connector(rig: Rig, g: Generator) -> Drawn:
    axis, change, share = int(g.integers(rig.n_axes)), _size(g, 0.03, 0.2) * _sign(g), float(g.uniform(0.2, 0.5))
    return Drawn(rig, LooseConnector(axis, change, share), {"axis": float(axis), "change": change, "from_share": share})


def _curved_probe(rig: Rig, g: Generator) -> Drawn:
    cubic = _size(g, 0.02, 0.5) * _sign(g)
    return Drawn(rig, CurvedProbe(cubic), {"cubic_per_a2": cubic})


def _unequal_planes(rig: Rig, g: Generator) -> Drawn:
    """A shaft that is stiffer in one plane than in the other, far beyond what machining leaves."""
    if not any(rig.rotor.modes[1:]):
        raise EffectError(f"rig {rig.name} has no modes in a second plane that could be stiffer")
    e = _size(g, 0.015, 0.06) * _sign(g)

    def stiffer(m: FlexibleMode) -> FlexibleMode:
        return replace(m, natural_frequency_rad_s=m.natural_frequency_rad_s * (1 + e))

    modes = tuple(tuple(stiffer(m) for m in p) if k else p for k, p in enumerate(rig.rotor.modes))
    return Drawn(replace(rig, rotor=replace(rig.rotor, modes=modes)), Tampering(), {"relative": e})


def _wrong_injection(rig: Rig, g: Generator) -> Drawn:
    gain, cubic = _size(g, 0.005, 0.1) * _sign(g), _size(g, 0.01, 0.3) * _sign(g)
    return Drawn(rig, WrongInjection(gain, cubic), {"gain_change": gain, "cubic_per_a2": cubic})


UNLISTED: dict[str, Callable[[Rig, Generator], Drawn]] = {
    "clipped_log": _clipped_log,
    "held_log": _held_log,
    "coarse_log": _coarse_log,
    "coarse_sensor": _coarse_sensor,
    "filtered_current_log": _filtered_current_log,
    "filtered_displacement_log": _filtered_displacement_log,
    "loose_connector": _loose_connector,
    "curved_probe": _curved_probe,
    "unequal_planes": _unequal_planes,
    "wrong_injection": _wrong_injection,
}
"""By name: (rig, generator) -> a law with its numbers drawn."""
