"""How far the gap shrinks on data that no fit has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.observation import Observation
from service.gap.predict import measured, residual, weights
from sim.rig import Rig

Real = NDArray[np.float64]

NOISE = 1.0
"""J of a right twin: residuals in units of their own standard deviation."""
RESAMPLES = 400


@dataclass(frozen=True)
class Shrinkage:
    """J = mean |residual|^2 / variance on the unseen sweep, before and after the effect is added."""

    held_out: str
    before: float
    after: float
    noise_floor: float
    closure: float
    closure_95: tuple[float, float]
    by_path: dict[str, float]
    """closure of u, i and y apart, where each had a gap"""


def per_point(rig: Rig, o: Observation) -> Real:
    """|residual|^2 / variance, mean over signals and harmonics, (P, 3): controller, amplifier, plant apart."""
    z, w = np.abs(residual(rig, o)) ** 2 / 2, weights(o) > 0
    n = rig.n_axes
    parts = []
    for k in range(3):
        used = w[..., k * n : (k + 1) * n]
        parts.append((z[..., k * n : (k + 1) * n] * used).sum(axis=(1, 2)) / np.maximum(used.sum(axis=(1, 2)), 1))
    return np.stack(parts, axis=1)


def closure_of(before: float, after: float, noise: float = NOISE) -> float:
    """1 - (J_after - J_noise) / (J_before - J_noise), between -inf and 1; 0 where nothing was to be closed.

    >>> closure_of(11.0, 2.0)
    0.9
    """
    if before <= noise:
        return 0.0
    return float(min(1.0, 1.0 - (after - noise) / (before - noise)))


def shrinkage(before: Rig, after: Rig, o: Observation, name: str, seed: int = 0) -> Shrinkage:
    """Closure with a 95 % interval from resampled lines (points of one line stand or fall together)."""
    b, a = per_point(before, o), per_point(after, o)
    used = [k for k in range(3) if k != 1 or o.I is not None]
    total_b, total_a = b[:, used].mean(axis=1), a[:, used].mean(axis=1)
    rng = np.random.default_rng(seed)
    lines = len(o.frequency_hz)
    sums = np.stack([np.bincount(o.line, x, lines) for x in (total_b, total_a, np.ones(len(o.line)))])
    drawn = sums[:, rng.integers(0, lines, (RESAMPLES, lines))].sum(axis=2)
    resampled = [closure_of(x / c, y / c) for x, y, c in drawn.T]
    low, high = np.quantile(resampled, [0.025, 0.975])
    by_path = {
        name_: closure_of(float(b[:, k].mean()), float(a[:, k].mean()))
        for k, name_ in enumerate(("controller", "amplifier", "plant"))
        if k in used and b[:, k].mean() > 2 * NOISE
    }
    J_b, J_a = float(total_b.mean()), float(total_a.mean())
    return Shrinkage(name, J_b, J_a, NOISE, closure_of(J_b, J_a), (float(low), float(high)), by_path)


def relative_gap(rig: Rig, o: Observation) -> float:
    """||measured - twin|| / ||measured||, each signal by its own size, fundamental, root mean square over signals."""
    z, w, m = residual(rig, o), weights(o), measured(o)
    return _relative(np.where(w > 0, z / np.maximum(w, 1e-300), 0), m, o, rig.n_axes)


def relative_noise(o: Observation, n_axes: int) -> float:
    """The same of noise alone."""
    w = weights(o)
    return _relative(np.where(w > 0, np.sqrt(2) / np.maximum(w, 1e-300), 0), measured(o), o, n_axes)


def _relative(e: NDArray[np.complex128] | Real, m: NDArray[np.complex128], o: Observation, n: int) -> float:
    f = o.fundamental
    shares = []
    for k in range(3):
        size = np.linalg.norm(m[:, f, k * n : (k + 1) * n])
        if size > 0:
            shares.append(float(np.linalg.norm(e[:, f, k * n : (k + 1) * n]) / size) ** 2)
    return float(np.sqrt(np.mean(shares)))
