"""Whether one plane moves when the other is excited: two planes of their own then lack something.

At standstill the model G(s, W) of four axes falls into two blocks, and the joint fit of all four is that of the planes
one by one. What is measured across the planes says whether that holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from service.distributions import normal_above
from service.experiment.data import Sweep
from service.identification.arrays import Complex
from service.identification.measured.points import planes_of

CHANCE = 1e-6
"""Of decoupled planes that are called coupled."""
RARE = 1e-4
"""Chance of a ratio beyond which it counts no more: a few points with a transient or hum are no coupling."""
LEAST_RELATIVE = 0.002
"""Response across planes, relative, below which nothing is said: what hum and sensor noise that is common leave."""


@dataclass(frozen=True)
class CrossPlane:
    """What the points of one plane show in the other one."""

    excited: str
    seen: str
    relative: float
    """Displacement there over displacement here, rms over the lines of the part that is above the noise."""
    over_noise: float
    """Mean square of its means over that of their noise."""
    coupled: bool

    def document(self) -> dict[str, object]:
        """As JSON."""
        return {
            "excited": self.excited,
            "seen": self.seen,
            "relative": self.relative,
            "over_noise": self.over_noise,
            "coupled": self.coupled,
        }


def cross_planes(sweep: Sweep, axes: tuple[str, ...]) -> tuple[CrossPlane, ...]:
    """Test every plane that is excited by itself against the others, from means and scatter of the blocks.

    Each mean over its own scatter is F distributed where nothing is coupled; their sum is tested as a normal one.
    """
    if sweep.kind != "stepped-sine" or 1 not in sweep.harmonics or sweep.U.shape[1] < 4:
        return ()
    planes, h = planes_of(axes), sweep.harmonic(1)
    out = []
    for here, own in planes.items():
        for there, other in planes.items():
            rows = np.isin(sweep.axis, own) & (sweep.amplitude_a > 0)
            y = sweep.Y[rows][:, :, h]
            y = y[np.isfinite(y).all(axis=(1, 2))]
            if here == there or len(y) < 5:
                continue
            out.append(_tested(here, there, y[:, :, list(own)], y[:, :, list(other)]))
    return tuple(out)


def _tested(here: str, there: str, own: Complex, other: Complex) -> CrossPlane:
    """``own``, ``other``: displacements of both planes, (P, B, 2)."""
    blocks = own.shape[1]
    mean = other.mean(axis=1)
    variance = np.maximum(np.var(other, axis=1, ddof=1) / blocks, 1e-300)
    most, expected, std = usual_ratio(blocks)
    ratio = np.minimum(np.abs(mean) ** 2 / variance, most)
    z = (ratio.mean() - expected) / (std / np.sqrt(ratio.size))
    above = np.maximum(np.abs(mean) ** 2 - variance, 0.0)
    relative = float(np.sqrt(above.sum() / np.sum(np.abs(own.mean(axis=1)) ** 2)))
    coupled = z > normal_above(CHANCE) and relative > LEAST_RELATIVE
    return CrossPlane(here, there, relative, float(np.mean(np.abs(mean) ** 2 / variance)), bool(coupled))


def usual_ratio(blocks: int) -> tuple[float, float, float]:
    """Largest ratio that counts, mean of ratios cut there, and standard deviation of the ratio, of decoupled planes.

    |mean|^2 over its variance from 4 or more blocks is F distributed with 2 and 2 m degrees of freedom, m = blocks - 1,
    and exceeds x with the probability (1 + x / m)^-m.
    """
    m = blocks - 1
    most = m * (RARE ** (-1 / m) - 1)
    expected = m / (m - 1) * (1 - (1 + most / m) ** (1 - m))
    return most, expected, m / (m - 1) * math.sqrt(m / (m - 2))


def told(found: CrossPlane) -> str:
    """A coupling in words."""
    return (
        f"plane {found.seen} moves by {100 * found.relative:.2g} % of plane {found.excited} when that is excited: the "
        "planes' models take them for decoupled; diagnose the gap (ambit gap diagnose), and measure at several speeds "
        "where the rotor turned"
    )
