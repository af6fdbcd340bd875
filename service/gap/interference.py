"""Interference: what is added to the signals at fixed frequencies, whatever the excitation.

It hardly changes a mean over blocks, as its phase drifts from block to block, but the blocks scatter where a harmonic
of a point comes near it. So it is looked for in the scatter: near the mains and their multiples, and near multiples of
the rotor's speed.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.observation import HUMMED, block_scatter, near_hum, usable
from service.gap.shrinkage import NOISE, RESAMPLES, Shrinkage, closure_of
from sim.rig import Rig

Real = NDArray[np.float64]

MAINS_HZ = tuple(mains * k for k in (1, 2, 3, 6) for mains in (50.0, 60.0))
"""The mains, and what rectifiers make of them."""
MULTIPLES = (1, 2, 3, 5)
NEAR = 0.06
"""Relative distance up to which a harmonic is near an interference."""
FAR = (0.45, 0.8)
"""Relative distances between which it is held against."""
LOUD = 1.8
"""Ratio of the variance near to the variance far from which an interference is named."""
CERTAIN = 8.0
"""Normal deviate from which it is."""
BINS = (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, HUMMED)
"""Relative distances over which its share of the variance is averaged."""


@dataclass(frozen=True)
class Interference:
    """One source of interference."""

    effect: str
    frequency_hz: float
    parameters: Mapping[str, float]
    std: float
    """of the amplitude"""
    level: float
    """mean log variance near it"""
    ratio: float
    """variance near it over variance far from it, in the signal that shows it most"""
    significance: float
    """normal deviate"""
    signal: str
    shape: tuple[float, ...]
    """mean variance ratio over `BINS`"""


def interference(sweep: Sweep, rig: Rig) -> list[Interference]:
    """Sources of interference that the scatter of a sweep's blocks shows, one of each kind at most."""
    sweep = usable(sweep)
    _, of_i, of_y = block_scatter(sweep, rig)
    signals = {"y": of_y} if sweep.I is None else {"i": of_i, "y": of_y}
    wanted: dict[str, tuple[float, ...]] = {"mains_interference": MAINS_HZ}
    if sweep.speed_rad_s:
        wanted["runout"] = (sweep.speed_rad_s / (2 * np.pi),)
    found = []
    for effect, frequencies in wanted.items():
        for signal, variance in signals.items():  # in i first: what moves the current moves the rotor too
            heard = [_heard(sweep, rig, effect, f, signal, variance) for f in frequencies]
            loud = [one for one in heard if one is not None]
            if loud:
                found.append(max(loud, key=lambda one: one.level))
                break
    return found


def _heard(
    sweep: Sweep, rig: Rig, effect: str, frequency_hz: float, signal: str, variance: Real
) -> Interference | None:
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    away = np.abs(at / frequency_hz - 1)
    quiet = ~_near_modes(at, rig) & (np.array(sweep.harmonics) > 0)
    near, far = quiet & (away < NEAR), quiet & (away > FAR[0]) & (away < FAR[1])
    if near.sum() < 4 or far.sum() < 4:
        return None
    level, floor = (np.log(np.maximum(variance[cells], 1e-300)).mean(axis=0) for cells in (near, far))
    blocks = sweep.Y.shape[1]
    # The log of a variance of B blocks scatters by about 1 / sqrt(B - 1); the channels share the interference.
    spread = float(np.sqrt((1 / near.sum() + 1 / far.sum()) / (blocks - 1)))
    heard = float((level - floor).mean())
    if heard < np.log(LOUD) or heard / spread < CERTAIN:
        return None
    ratio = variance / np.exp(floor)
    shape = tuple(
        float(ratio[inside].mean()) if (inside := quiet & (away >= low) & (away < high)).any() else 1.0
        for low, high in itertools.pairwise(BINS)
    )
    amplitude = float(np.sqrt(variance[near].mean(axis=1).max() * (blocks - 1)))
    return Interference(
        effect,
        frequency_hz,
        _parameters(effect, frequency_hz, signal, amplitude),
        amplitude * spread / 2,
        float(level.mean()),
        float(np.exp(heard)),
        heard / spread,
        signal,
        shape,
    )


def _parameters(effect: str, frequency_hz: float, signal: str, amplitude: float) -> dict[str, float]:
    if effect == "runout":
        return {"amplitude_m": amplitude}
    name, other = ("amplitude_a", "amplitude_m") if signal == "i" else ("amplitude_m", "amplitude_a")
    return {name: amplitude, other: 0.0, "frequency_hz": frequency_hz}


def _near_modes(at_hz: Real, rig: Rig) -> NDArray[np.bool_]:
    modes = np.array([m.natural_frequency_rad_s for plane in rig.rotor.modes for m in plane]) / (2 * np.pi)
    return np.asarray(np.any(np.abs(at_hz[..., None] - modes) < 0.1 * modes, axis=-1))


def scatter_shrinkage(sweep: Sweep, rig: Rig, sources: Sequence[Interference], name: str) -> Shrinkage | None:
    """How far the scatter near the sources shrinks to the quiet one once they are counted in.

    ``sweep`` is one that was not used to find them; None where it comes near none of them.
    """
    sweep = usable(sweep)
    _, of_i, of_y = block_scatter(sweep, rig)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    quiet = ~_near_modes(at, rig) & (np.array(sweep.harmonics) > 0)
    before, after = np.empty(0), np.empty(0)
    for source in sources:
        variance, away = (of_i if source.signal == "i" else of_y), np.abs(at / source.frequency_hz - 1)
        far, near = quiet & ~near_hum(sweep, (source.frequency_hz,)), quiet & (away < NEAR)
        if not near.any() or not far.any():
            continue
        floor = np.exp(np.log(np.maximum(variance[far], 1e-300)).mean(axis=0))
        ratio = (variance / floor)[near].mean(axis=1)
        expected = np.array(source.shape)[np.searchsorted(BINS, away[near], side="right") - 1]
        before = np.concatenate([before, ratio])
        after = np.concatenate([after, ratio / np.maximum(expected, 1.0)])
    if not len(before):
        return None
    drawn = np.random.default_rng(0).integers(0, len(before), (RESAMPLES, len(before)))
    resampled = [
        closure_of(float(b), float(a)) for b, a in zip(before[drawn].mean(1), after[drawn].mean(1), strict=True)
    ]
    low, high = np.quantile(resampled, [0.025, 0.975])
    J_b, J_a = float(before.mean()), float(after.mean())
    return Shrinkage(name, J_b, J_a, NOISE, closure_of(J_b, J_a), (float(low), float(high)), {})


def hums_hz(sources: Sequence[Interference]) -> tuple[float, ...]:
    """Frequencies at which the sources are to be expected."""
    return tuple(k * s.frequency_hz for s in sources for k in MULTIPLES)
