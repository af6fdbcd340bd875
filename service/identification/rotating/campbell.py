"""The Campbell diagram: whirl of the levitated rotor and of the free one over the speed, and its critical speeds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from service.identification.arrays import Real
from service.identification.joint.uncertainty import Uncertainty
from service.identification.rotating.model import RotatingModel
from service.identification.rotating.whirl import Whirl, whirl

PLANAR = 0.1
"""Direction of turn, -1 to 1, below which a whirl counts as to and fro."""
SPEEDS = 11
"""Of the diagram, from standstill to `BEYOND` times the highest that was measured."""
BEYOND = 1.25


@dataclass(frozen=True)
class Branch:
    """One whirl over the speed; nan where it is damped too well to ring."""

    direction: str
    """"forward", "backward" or "planar", at the highest speed."""
    frequency: Real
    """(S,) rad/s; so is ``frequency_std``."""
    frequency_std: Real
    damping_ratio: Real
    """(S,); so is ``damping_std``."""
    damping_std: Real
    turn: Real
    """(S,) of the sensors' orbits, -1 a circle against the shaft, 1 one with it; nan for the free rotor."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "direction": self.direction,
            "frequency_hz": (self.frequency / (2 * np.pi)).tolist(),
            "frequency_std_hz": (self.frequency_std / (2 * np.pi)).tolist(),
            "damping_ratio": self.damping_ratio.tolist(),
            "damping_std": self.damping_std.tolist(),
            "turn": self.turn.tolist(),
        }


@dataclass(frozen=True)
class Critical:
    """A speed at which a whirl of the levitated rotor meets the synchronous line."""

    speed_rad_s: float
    std: float
    direction: str
    damping_ratio: float


@dataclass(frozen=True)
class Campbell:
    """Whirl over the speed."""

    speed_rad_s: Real
    """(S,)"""
    levitated: tuple[Branch, ...]
    """Of the running loop, with the datasheet's controller."""
    free: tuple[Branch, ...]
    """Flexible modes of the rotor alone."""
    critical: tuple[Critical, ...]

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "speed_rad_s": self.speed_rad_s.tolist(),
            "levitated": [b.document() for b in self.levitated],
            "free_rotor": [b.document() for b in self.free],
            "critical_speeds": [
                {"speed_rad_s": c.speed_rad_s, "std": c.std, "direction": c.direction, "damping_ratio": c.damping_ratio}
                for c in self.critical
            ],
        }


def campbell(
    model: RotatingModel,
    controller: tuple[Real, Real],
    u: Uncertainty,
    fastest_rad_s: float,
    highest_rad_s: float,
) -> Campbell:
    """Diagram up to `BEYOND` times the fastest measured speed, for whirls below a frequency.

    Forward is the way that the shaft turns, from x to y at a positive speed.
    """
    sense = float(np.sign(fastest_rad_s)) or 1.0
    speeds = np.linspace(0.0, BEYOND * abs(fastest_rad_s), SPEEDS) * sense
    found = [whirl(model, controller, float(w), u.covariance, u.free, highest_rad_s) for w in speeds]
    found = [replace(w, direction=sense * w.direction) for w in found]
    levitated = tracked(found)
    return Campbell(speeds, levitated, free_whirl(model, u, speeds), critical_speeds(speeds, levitated))


def tracked(found: list[Whirl]) -> tuple[Branch, ...]:
    """Whirls of neighbouring speeds joined by frequency and shape, from the highest speed down."""
    n_speeds = len(found)
    rows: list[list[int]] = [[-1] * n_speeds for _ in found[-1].pole]
    last = [(n_speeds - 1, k) for k in range(len(rows))]
    for row, (at, k) in zip(rows, last, strict=True):
        row[at] = k
    for at in range(n_speeds - 2, -1, -1):
        now = found[at]
        if not last or not len(now.pole):
            continue
        cost = np.array([[_apart(found[s], k, now, j) for j in range(len(now.pole))] for s, k in last])
        taken: set[int] = set()
        for r, j in np.transpose(linear_sum_assignment(cost)).tolist():
            if cost[r, j] < 1.0:
                rows[r][at], last[r] = j, (at, j)
                taken.add(j)
        for j in sorted(set(range(len(now.pole))) - taken):  # one that rings at lower speeds only
            rows.append([-1] * n_speeds)
            rows[-1][at] = j
            last.append((at, j))
    branches = [_branch(found, row) for row in rows]
    return tuple(sorted(branches, key=lambda b: float(np.nanmean(b.frequency))))


def _apart(a: Whirl, k: int, b: Whirl, j: int) -> float:
    """Distance of two whirls: relative distance of the poles, in twentieths, and unlikeness of shapes."""
    poles = abs(a.pole[k] - b.pole[j]) / abs(a.pole[k])
    return float(20 * poles + 0.5 * (1 - abs(np.vdot(a.shape[k], b.shape[j])) ** 2))


def _branch(found: list[Whirl], row: list[int]) -> Branch:
    def of(name: str) -> Real:
        return np.array([np.nan if k < 0 else float(getattr(w, name)[k]) for w, k in zip(found, row, strict=True)])

    turn = of("direction")
    last = float(turn[np.isfinite(turn)][-1])
    return Branch(
        _word(last),
        of("frequency"),
        of("frequency_std"),
        of("damping_ratio"),
        of("damping_std"),
        turn,
    )


def _word(turn: float) -> str:
    return "planar" if abs(turn) < PLANAR else "forward" if turn > 0 else "backward"


def free_whirl(model: RotatingModel, u: Uncertainty, speeds: Real) -> tuple[Branch, ...]:
    """Backward and forward whirl of each pair of modes of the rotor alone."""
    pairs = model.layout.pairs
    if not pairs:
        return ()

    def figures(m: RotatingModel) -> Real:
        poles = np.array([[_free_poles(m, k, float(w)) for w in speeds] for k in range(len(pairs))])
        return np.concatenate([poles.imag.ravel(), (-poles.real / np.abs(poles)).ravel()])

    values, (std, _) = figures(model), u.std(model, figures)
    shape = (2, len(pairs), len(speeds), 2)
    values, std = values.reshape(shape), std.reshape(shape)
    out = []
    for k in range(len(pairs)):
        g = model.coupling(k)[0]
        # the forward whirl is the one that the gyroscopic moment stiffens
        words = ("backward", "forward") if g > 0 else ("forward", "backward") if g < 0 else ("planar", "planar")
        for j, word in enumerate(words):
            out.append(
                Branch(
                    word,
                    values[0, k, :, j],
                    std[0, k, :, j],
                    values[1, k, :, j],
                    std[1, k, :, j],
                    np.full(len(speeds), np.nan),
                )
            )
    return tuple(out)


def _free_poles(model: RotatingModel, pair: int, speed: float) -> np.ndarray:
    """Lower and upper pole of two coupled modes, Im > 0."""
    a, b = model.layout.pairs[pair]
    planes = model.planes
    sigma = np.array([planes[0].modes[a, 1], planes[1].modes[b, 1]])
    square = np.array([planes[0].natural_frequencies[a], planes[1].natural_frequencies[b]]) ** 2
    g, h = model.coupling(pair)
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]]) * speed
    stiffness, damping = np.diag(square) + 2 * h * turn, np.diag(2 * sigma) + g * turn
    poles = np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]]))
    upper = poles[np.argsort(-poles.imag)[:2]]
    return np.asarray(upper[np.argsort(upper.imag)])


def critical_speeds(speeds: Real, branches: tuple[Branch, ...]) -> tuple[Critical, ...]:
    """Where whirls of the running loop meet the synchronous line, by interpolation between the diagram's speeds."""
    out = []
    for branch in branches:
        gap = branch.frequency - np.abs(speeds)
        for k in np.flatnonzero((gap[:-1] > 0) & (gap[1:] <= 0)):
            share = gap[k] / (gap[k] - gap[k + 1])
            slope = np.diff(branch.frequency)[k] / np.diff(np.abs(speeds))[k]

            def at(values: Real, k: int = int(k), share: float = float(share)) -> float:
                return float(values[k] + share * (values[k + 1] - values[k]))

            out.append(
                Critical(
                    at(np.abs(speeds)),
                    at(branch.frequency_std) / max(abs(1.0 - float(slope)), 1e-3),
                    _word(at(branch.turn)),
                    at(branch.damping_ratio),
                )
            )
    return tuple(sorted(out, key=lambda c: c.speed_rad_s))
