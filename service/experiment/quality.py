"""Is a finished point good enough, and if not, what to change. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.experiment.knowledge import Knowledge
from service.experiment.plan import Aim, Limits, largest_amplitude, needed_amplitude
from service.experiment.points import Point
from service.experiment.settling import Agreement, agreement

DISTORTION = 0.05
"""Share of harmonics in the current above which an amplifier is at its voltage or current limit."""
OVERSHOOT = 1.5
"""A response that far above its wanted largest value is repeated lower."""
WEAKNESS = 2.0
"""A point is repeated higher when that times the amplitude was needed and allowed."""


@dataclass(frozen=True)
class Judgement:
    """What a point lacks; all False for a good one."""

    agreement: Agreement
    saturated: bool
    too_large: bool
    too_small: bool
    better_amplitude_a: float
    """Amplitude to repeat with, where amplitude is what is wrong."""


def settled(point: Point, knowledge: Knowledge, aim: Aim, sample_rate_hz: float) -> Agreement:
    """Agreement of the blocks of all displacements and of the excited axis's current."""
    k = point.request.axis
    blocks = np.concatenate([point.Y[:, 1], point.I[:, 1, k : k + 1]], axis=1)
    variance = knowledge.noise.block_variance(point.frequency_hz, point.request.samples / sample_rate_hz)
    y_size = float(np.linalg.norm(point.Y[:, 1].mean(axis=0)))
    i_size = float(abs(point.I[:, 1, k].mean()))
    n = point.Y.shape[2]
    negligible = 0.25 * aim.accuracy * np.array([y_size] * n + [i_size])
    return agreement(blocks, np.append(variance["y"], variance["i"][k]), negligible)


def distortion(point: Point) -> float:
    """Largest harmonic of the excited axis's current above what its scatter explains, over the fundamental."""
    current = point.I[:, :, point.request.axis]
    first = abs(current[:, 1].mean())
    if first == 0:
        return 0.0
    mean = np.abs(current[:, 2:].mean(axis=0))
    scatter = current[:, 2:].std(axis=0) / np.sqrt(max(1, len(current) - 1))
    return float(np.max(np.maximum(mean - 3 * scatter, 0), initial=0.0) / first)


def judge(point: Point, knowledge: Knowledge, aim: Aim, limits: Limits) -> Judgement:
    """What a point lacks, with the point itself already part of what is known."""
    axis, f, a = point.request.axis, point.frequency_hz, point.request.amplitude_a
    seconds = point.request.blocks * point.request.samples / limits.sample_rate_hz
    largest = largest_amplitude(knowledge, axis, f, aim, limits)
    wanted = min(largest, needed_amplitude(knowledge, axis, f, aim, seconds))
    saturated = distortion(point) > DISTORTION
    too_large = a > OVERSHOOT * largest
    too_small = WEAKNESS * a < wanted and not saturated
    return Judgement(
        agreement=settled(point, knowledge, aim, limits.sample_rate_hz),
        saturated=saturated,
        too_large=too_large,
        too_small=too_small,
        better_amplitude_a=min(wanted, largest) if too_large or too_small else a / 2,
    )
