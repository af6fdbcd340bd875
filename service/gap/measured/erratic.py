"""Erratic points: those whose current does not repeat from block to block, so that there is no amplitude to fit.

The current loop of an amplifier at its voltage limit may lose stability and then oscillates beside the tone that drives
it. Whatever else changes from block to block (a resonance that still rings, a drift, noise in the feedback loop) is in
the control signal too, which the current of a linear amplifier follows by one factor. So what counts is the scatter of
the current about a regression on the control signal. What scatters and does follow it is the loop: it rings, hardly
stable or not settled yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.coherent import deviation
from service.gap.measured.settling import ENOUGH_BLOCKS

Real = NDArray[np.float64]

ERRATIC = 0.1
"""Scatter of a point's current, relative to its mean, from which it is erratic. On 250 sweeps of another program this
and `TIMES_MEDIAN` marked exactly those whose amplifiers had lost their loop, which had 0.15 to 0.7; without
`TIMES_MEDIAN` noise has as much where the current is small."""
ERRATIC_BESIDE = 0.05
"""Scatter from which other axes of a line with an erratic point count as erratic, too."""
TIMES_MEDIAN = 30.0
"""Factor by which the scatter must also exceed the median of the sweep's points, relative to the mean and in itself:
noise is alike in all, and large beside a small current."""
FOLLOWS = 0.1
"""Share of a current's scatter about the control signal below which it follows that, as at no limit. Where a loop rang
it was 0.01, for what changes within a block; where amplifiers had lost their loop 0.2 at least."""
LARGEST_ERRATIC_SHARE = 0.25
"""Share of a sweep's lines up to which they may be erratic: a limit is met in a few lines; scatter in more is noise of
a current probe, and is weighted as that."""
FEWEST_AXES = 2
"""Axes that must be erratic at one frequency for the rig to be the cause, and not one disturbed record."""


@dataclass(frozen=True)
class Erratic:
    """Lines at which the currents of several axes do not repeat from block to block."""

    words: str
    points: Sweep
    """the erratic points of one sweep"""
    steepest_a_per_s: float
    """largest slope of a current, at its excited frequency, among the points that do repeat"""


def erratic(sweep: Sweep) -> NDArray[np.bool_]:
    """Which points are erratic, (P,); none where the current was not logged, or where blocks are too few."""
    if sweep.I is None or sweep.Y.shape[1] < ENOUGH_BLOCKS or not sweep.n_points:
        return np.zeros(sweep.n_points, dtype=bool)
    size, scatter, about_u = _scatter_of_current(sweep)
    relative = about_u / np.maximum(size, np.finfo(float).tiny)
    outlying = (relative > TIMES_MEDIAN * np.median(relative)) & (about_u > TIMES_MEDIAN * np.median(about_u))
    outlying &= about_u > FOLLOWS * scatter
    lines = np.unique(sweep.frequency_hz[outlying & (relative > ERRATIC)])
    if len(lines) > LARGEST_ERRATIC_SHARE * len(np.unique(sweep.frequency_hz)):
        return np.zeros(sweep.n_points, dtype=bool)
    return np.asarray(np.isin(sweep.frequency_hz, lines) & outlying & (relative > ERRATIC_BESIDE))


def ringing(sweep: Sweep) -> NDArray[np.bool_]:
    """Points whose current scatters by more than its mean, as no noise would, and follows the control signal, (P,)."""
    if sweep.I is None or sweep.Y.shape[1] < ENOUGH_BLOCKS or not sweep.n_points:
        return np.zeros(sweep.n_points, dtype=bool)
    size, scatter, about_u = _scatter_of_current(sweep)
    loud = (scatter > size) & (scatter > TIMES_MEDIAN * np.median(scatter))
    return np.asarray(loud & (about_u < FOLLOWS * scatter))


def ringing_in_words(sweep: Sweep, axes: Sequence[str], name: str) -> list[str]:
    """A sentence on the lines where the loop rings in several axes; none without."""
    of = ringing(sweep)
    hz, count = np.unique(sweep.frequency_hz[of], return_counts=True)
    there = hz[count >= FEWEST_AXES]
    if not len(there):
        return []
    which = sorted(set(sweep.axis[of & np.isin(sweep.frequency_hz, there)].tolist()))
    at = f"{there[0]:.4g} Hz" if len(there) == 1 else f"{len(there)} lines from {there[0]:.4g} to {there[-1]:.4g} Hz"
    return [
        f"at {at} in {name} the currents of {', '.join(axes[a] for a in which)} change from block to block by more "
        "than they are, as their control signals do: the loop rings there, hardly stable or not settled yet; let it "
        "settle longer, or give it more damping"
    ]


def _scatter_of_current(sweep: Sweep) -> tuple[Real, Real, Real]:
    """Of each excited axis's current, (P,) each: its mean, its scatter, and that about what follows u."""
    assert sweep.I is not None
    points, f, blocks = np.arange(sweep.n_points), sweep.harmonics.index(1), sweep.Y.shape[1]
    I = sweep.I[points, :, f, sweep.axis]
    u, i = deviation(sweep.U[points, :, f, sweep.axis]), deviation(I)
    factor = np.sum(u.conj() * i, axis=1) / np.maximum(np.sum(np.abs(u) ** 2, axis=1), np.finfo(float).tiny)
    scatter = np.sqrt(np.sum(np.abs(i) ** 2, axis=1) / (blocks - 1))
    about_u = np.sqrt(np.sum(np.abs(i - factor[:, None] * u) ** 2, axis=1) / (blocks - 2))
    return np.abs(I.mean(axis=1)), scatter, about_u


def erratic_in_words(sweep: Sweep, of: NDArray[np.bool_], axes: Sequence[str], name: str) -> list[tuple[str, bool]]:
    """A sentence on each line with erratic points, and whether several axes are erratic there.

    ``of`` marks the erratic points, (P,).
    """
    sentences = []
    for hz in np.unique(sweep.frequency_hz[of]):
        there = sorted(set(sweep.axis[of & (sweep.frequency_hz == hz)].tolist()))
        words = (
            f"at {hz:.4g} Hz in {name} the currents of {', '.join(axes[a] for a in there)} do not repeat from block to "
            "block, as of amplifiers that lose their loop where their voltage ends"
        )
        sentences.append((words, len(there) >= FEWEST_AXES))
    return sentences


def steepest(sweep: Sweep) -> float:
    """Largest slope of an excited axis's current at its frequency, A/s; 0 without points or logged current."""
    if sweep.I is None or not sweep.n_points:
        return 0.0
    I = sweep.I[np.arange(sweep.n_points), :, sweep.harmonics.index(1), sweep.axis].mean(axis=1)
    return float((2 * np.pi * sweep.frequency_hz * np.abs(I)).max())
