"""Points at which an amplifier does not answer alike from block to block: there is no amplitude to fit.

An amplifier at its voltage limit may lose its loop, and then oscillates beside the tone that drives it. Whatever else
changes from block to block (a resonance that still rings, a drift, noise that feedback carries round) is in the
control signal too, and a linear amplifier's current follows it by one factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.coherent import deviation
from service.gap.measured.settling import ENOUGH_BLOCKS

ERRATIC = 0.1
"""Scatter of a point's current about what follows the control signal, relative to its mean, from which it is erratic.
On 250 sweeps of another program that and `UNLIKE` marked those whose amplifiers had lost their loop, by 0.15 to 0.7,
and no other one; without `UNLIKE` noise has as much where the current is small."""
ERRATIC_BESIDE = 0.05
"""The same of the other axes of such a line that are named with it."""
UNLIKE = 30.0
"""Times the median of a sweep's points that such scatter must exceed besides: noise is alike in all."""
LARGEST_ERRATIC_SHARE = 0.25
"""Share of a sweep's lines up to which they are left out: a limit is met in a few; what is so everywhere is noise of a
probe, and is weighed as that."""
FEWEST_AXES = 2
"""Axes that are erratic at one frequency from which it is the rig, and not one disturbed record."""


@dataclass(frozen=True)
class Erratic:
    """Where amplifiers of several axes do not answer alike from block to block."""

    words: str
    points: Sweep
    """those that do not, of one sweep"""
    steepest_a_per_s: float
    """largest slope of a current, at its excited frequency, that does repeat"""


def erratic(sweep: Sweep) -> NDArray[np.bool_]:
    """Which points are erratic, (P,); none where the current was not logged, or where blocks are too few."""
    blocks, points = sweep.Y.shape[1], np.arange(sweep.n_points)
    if sweep.I is None or blocks < ENOUGH_BLOCKS or not sweep.n_points:
        return np.zeros(sweep.n_points, dtype=bool)
    f = sweep.harmonics.index(1)
    I = sweep.I[points, :, f, sweep.axis]
    u, i = deviation(sweep.U[points, :, f, sweep.axis]), deviation(I)
    tiny = np.finfo(float).tiny
    factor = np.sum(u.conj() * i, axis=1) / np.maximum(np.sum(np.abs(u) ** 2, axis=1), tiny)
    scatter = np.sqrt(np.sum(np.abs(i - factor[:, None] * u) ** 2, axis=1) / (blocks - 2))
    relative = scatter / np.maximum(np.abs(I.mean(axis=1)), tiny)
    unlike = relative > UNLIKE * np.median(relative)
    lines = np.unique(sweep.frequency_hz[unlike & (relative > ERRATIC)])
    if len(lines) > LARGEST_ERRATIC_SHARE * len(np.unique(sweep.frequency_hz)):
        return np.zeros(sweep.n_points, dtype=bool)
    return np.asarray(np.isin(sweep.frequency_hz, lines) & unlike & (relative > ERRATIC_BESIDE))


def erratic_in_words(sweep: Sweep, of: NDArray[np.bool_], axes: Sequence[str], name: str) -> list[tuple[str, bool]]:
    """What is said of each line with erratic points, and whether it is the rig, several axes being erratic there."""
    told = []
    for hz in np.unique(sweep.frequency_hz[of]):
        there = sorted(set(sweep.axis[of & (sweep.frequency_hz == hz)].tolist()))
        words = (
            f"at {hz:.4g} Hz in {name} the currents of {', '.join(axes[a] for a in there)} do not repeat from block to "
            "block, as of amplifiers that lose their loop where their voltage ends"
        )
        told.append((words, len(there) >= FEWEST_AXES))
    return told


def steepest(sweep: Sweep) -> float:
    """Largest slope of an excited axis' current at its frequency, A/s; 0 of no points, or where it was not logged."""
    if sweep.I is None or not sweep.n_points:
        return 0.0
    I = sweep.I[np.arange(sweep.n_points), :, sweep.harmonics.index(1), sweep.axis].mean(axis=1)
    return float((2 * np.pi * sweep.frequency_hz * np.abs(I)).max())
