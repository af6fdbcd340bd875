"""Gain, phase and delay margins of a loop with others closed, and where it meets its limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.arrays import Complex, Real

CLOSE = 1e-5
"""Half the relative distance of two frequencies between which a loop counts as straight."""
PARTS, ROUNDS = 8, 3
"""Parts into which what lies between the two lines about a crossing is divided, and how often: where a sharp mode turns
the loop by a right angle from line to line, a five-hundredth of it is straight."""
REST = 1e-3
"""A loop at this frequency is at rest, rad/s: slower than any part of it but an integrator."""


@dataclass(frozen=True)
class Crossing:
    """A margin, and the frequency where the loop would meet its limit, rad/s."""

    value: float
    omega: float


@dataclass(frozen=True)
class LoopMargins:
    """How far a loop L is from -1; None where no such change meets the limit."""

    gain_down_db: Crossing | None
    gain_up_db: Crossing | None
    phase_deg: Crossing | None
    delay_s: Crossing | None

    def crossings(self) -> tuple[Crossing | None, Crossing | None, Crossing | None, Crossing | None]:
        """In the order of the fields."""
        return self.gain_down_db, self.gain_up_db, self.phase_deg, self.delay_s

    def values(self) -> tuple[float | None, float | None, float | None, float | None]:
        """The margins alone."""
        down, up, phase, delay = (None if c is None else c.value for c in self.crossings())
        return down, up, phase, delay

    def places(self) -> Real:
        """Pairs of frequencies about each crossing, (4, 2) rad/s, nan without one; to both sides of rest."""
        at = np.array([np.nan if c is None else c.omega for c in self.crossings()])
        away = np.where(at == 0, REST, CLOSE * at)
        return np.stack([at - away, at + away], axis=1)


def loop_margins(omega: Real, loop: Complex) -> LoopMargins:
    """Margins of L = 1/S - 1 from its values at rising frequencies, straight in between.

    Gain margins in dB: how far the gain may fall (negative) and rise; phase in degrees; delay in s. L(-w) = L(w)*, so a
    loop that does not integrate is real at rest, too: an unstable plant falls there when the gain falls. That is seen
    where the frequencies begin at `REST`.
    """
    return _margins(omega, loop, _Brackets.of(omega, loop[:, None]), 0)


def margins_of_loops(omega: Real, loops: Complex, exact: Callable[[Real], Complex]) -> tuple[LoopMargins, ...]:
    """The same of n loops, (P, n), each crossing looked for between its two lines.

    About a sharp mode a loop is not straight from one line to the next: there gain margins were off by half a decibel.

    Parameters
    ----------
    exact
        Frequencies, rad/s, (M,) -> the loops there, (M, n).
    """
    brackets = _Brackets.of(omega, loops)
    for _ in range(ROUNDS):
        brackets = brackets.divided(exact)
    return tuple(_margins(omega, loops[:, j], brackets, j) for j in range(loops.shape[1]))


@dataclass(frozen=True)
class _Brackets:
    """Pairs of frequencies between which a loop becomes real, or passes the size of one."""

    omega: Real
    """(K, 2) rad/s, the lower one first."""
    loop: Complex
    """(K, 2)"""
    which: NDArray[np.int64]
    """(K,) of the loops."""
    of_size: NDArray[np.bool_]
    """(K,) whether its size passes one; else it is real."""

    @classmethod
    def of(cls, omega: Real, loops: Complex) -> _Brackets:
        """At rising frequencies, (P,) and (P, n)."""
        found = []
        for of_size, height in ((False, loops.imag), (True, np.abs(loops) - 1)):
            which, k = np.nonzero((height[:-1] * height[1:] < 0).T)
            ends = np.stack([k, k + 1], axis=1)
            found.append(cls(omega[ends], loops[ends, which[:, None]], which, np.full(len(k), of_size)))
        real, one = found
        return cls(
            np.concatenate([real.omega, one.omega]),
            np.concatenate([real.loop, one.loop]),
            np.concatenate([real.which, one.which]),
            np.concatenate([real.of_size, one.of_size]),
        )

    def divided(self, exact: Callable[[Real], Complex]) -> _Brackets:
        """The parts of them in which it happens."""
        if not len(self.omega):
            return self
        omega = self.omega[:, :1] + np.diff(self.omega, axis=1) * np.linspace(0.0, 1.0, PARTS + 1)
        inner = exact(omega[:, 1:-1].ravel()).reshape(len(omega), PARTS - 1, -1)
        own = np.take_along_axis(inner, self.which[:, None, None], axis=2)[..., 0]
        loop = np.hstack([self.loop[:, :1], own, self.loop[:, 1:]])
        beyond = np.where(self.of_size[:, None], np.abs(loop) - 1, loop.imag) >= 0
        row, k = np.nonzero(beyond[:, :-1] != beyond[:, 1:])
        ends = np.stack([k, k + 1], axis=1)
        return _Brackets(omega[row[:, None], ends], loop[row[:, None], ends], self.which[row], self.of_size[row])


def _margins(omega: Real, loop: Complex, brackets: _Brackets, j: int) -> LoopMargins:
    """Of loop ``j``, straight within each of its brackets."""
    down: Crossing | None = None
    up: Crossing | None = None
    real, one = (np.flatnonzero((brackets.which == j) & (brackets.of_size == of_size)) for of_size in (False, True))
    gains = [_gain(brackets.omega[k], brackets.loop[k]) for k in real]
    if omega[0] <= REST and abs(loop[0].imag) < 0.1 * abs(loop[0].real):
        gains.append(_gain(omega[0] * np.array([-1.0, 1.0]), np.array([loop[0].conj(), loop[0]])))
    for db, w in gains:
        if math.isnan(db):
            continue
        if db < 0:
            down = Crossing(db, w) if down is None or db > down.value else down
        else:
            up = Crossing(db, w) if up is None or db < up.value else up
    phase: Crossing | None = None
    delay: Crossing | None = None
    for k in one:
        away, late, w = _phase(brackets.omega[k], brackets.loop[k])
        phase = Crossing(away, w) if phase is None or away < phase.value else phase
        delay = Crossing(late, w) if delay is None or late < delay.value else delay
    return LoopMargins(down, up, phase, delay)


def moved(places: Real, loop: Complex) -> Real:
    """The same margins of another loop that differs a little, (4,) nan without one.

    Parameters
    ----------
    places
        `LoopMargins.places` of the first one.
    loop
        (4, 2) of the other one there.
    """
    out = np.full(4, np.nan)
    for k in np.flatnonzero(np.isfinite(places[:, 0])):
        out[k] = _gain(places[k], loop[k])[0] if k < 2 else _phase(places[k], loop[k])[k - 2]
    return out


def _gain(omega: Real, loop: Complex) -> tuple[float, float]:
    """Gain in dB that puts the loop on -1 where it is real, and that frequency; nan where it is positive there."""
    (a, b), (p, q) = loop.imag, loop.real
    t = a / (a - b) if a != b else 0.5
    x = p + t * (q - p)
    if not x < -1e-6:
        return math.nan, math.nan
    return -20 * math.log10(-x), float(omega[0] + t * (omega[1] - omega[0]))


def _phase(omega: Real, loop: Complex) -> tuple[float, float, float]:
    """Phase in degrees and delay in s that put the loop on -1 where its size is 1, and that frequency."""
    a, b = np.abs(loop)
    t = (a - 1) / (a - b) if a != b else 0.5
    angle = float(np.angle(loop[0] * (1 - t) + loop[1] * t))
    w = float(omega[0] + t * (omega[1] - omega[0]))
    return math.degrees(math.pi - abs(angle)), (angle + math.pi) % (2 * math.pi) / w, w
