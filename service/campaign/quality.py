"""Is a finished point good enough, and if not, what to change. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.campaign.aims import Aim, Limits
from service.campaign.knowledge import Knowledge
from service.campaign.plan import largest_amplitude, needed_amplitude
from service.campaign.points import Point
from service.campaign.settling import Agreement, agreement

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

DISTORTION = 0.05
"""Share of harmonics in the current above which an amplifier is at its voltage or current limit."""
COMPRESSION = 0.8
"""A response per ampere that falls below that share when the amplitude is raised shows the same limit."""
OVERSHOOT = 1.5
"""A response that far above its wanted largest value is repeated lower."""
WEAKNESS = 2.0
"""A point is repeated higher when that times the amplitude was needed and allowed."""


STEP_UP = 4.0
"""An amplitude is raised that much at once: what holds at a small amplitude need not at a large one."""


VISIBLE = 5.0
"""Standard deviations of noise above which a current is large enough for its shape to mean something."""


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
    """Agreement of the blocks: of all displacements, and of what drives them in the excited plane.

    Both are looked at, each against its own size: near a resonance the displacement is large where the control
    signal is small, and the response is the quotient of both.
    """
    k = point.request.axis
    plane = [a for a in (k // 2 * 2, k // 2 * 2 + 1) if a < point.Y.shape[2]]
    variance = knowledge.noise.block_variance(point.frequency_hz, point.request.samples / sample_rate_hz)
    moved = _group([(point.Y[:, 1], variance["y"])], aim)
    drive = _group(
        [(point.U[:, 1, plane], variance["u"][plane]), (point.I[:, 1, k : k + 1], variance["i"][k : k + 1])], aim
    )
    return Agreement(max(moved.excess, drive.excess), max(moved.drift, drive.drift), moved.settled and drive.settled)


def _group(signals: list[tuple[Complex, Real]], aim: Aim) -> Agreement:
    """Agreement of signals (B, n) with their noise variances (n,); a quarter of the accuracy does not matter."""
    negligible = [np.full(x.shape[1], 0.25 * aim.accuracy * float(np.linalg.norm(x.mean(axis=0)))) for x, _ in signals]
    return agreement(
        np.concatenate([x for x, _ in signals], axis=1),
        np.concatenate([v for _, v in signals]),
        np.concatenate(negligible),
    )


def visible(point: Point, knowledge: Knowledge, sample_rate_hz: float) -> bool:
    """Whether the excited axis's current stands out of the noise and of its converter's steps, so can be judged."""
    axis, seconds = point.request.axis, point.request.samples / sample_rate_hz
    noise = knowledge.noise.mean_variance(point.frequency_hz, seconds, point.request.blocks)["i"][axis]
    return bool(abs(point.I[:, 1, axis].mean()) > VISIBLE * np.sqrt(noise))


def distortion(point: Point, knowledge: Knowledge, sample_rate_hz: float) -> float:
    """Largest harmonic of the excited axis's current over its fundamental, less what the rig does at rest there."""
    axis = point.request.axis
    current = point.I[:, :, axis].mean(axis=0)
    seconds = point.request.samples / sample_rate_hz
    largest = 0.0
    for h in range(2, len(current)):
        if h * point.frequency_hz < sample_rate_hz / 2:
            variance = knowledge.noise.mean_variance(h * point.frequency_hz, seconds, point.request.blocks)["i"][axis]
            largest = max(largest, float(np.abs(current[h]) - 3 * np.sqrt(variance)))
    return largest / float(np.abs(current[1]))


def compressed(point: Point, before: Point | None) -> bool:
    """Whether more excitation brought less than its share of current: the amplifier gives no more."""
    if before is None or point.request.amplitude_a <= before.request.amplitude_a:
        return False
    axis = point.request.axis
    return bool(abs(point.per_ampere()[1][axis]) < COMPRESSION * abs(before.per_ampere()[1][axis]))


def judge(point: Point, knowledge: Knowledge, aim: Aim, limits: Limits, before: Point | None = None) -> Judgement:
    """What a point lacks, with the point itself already part of what is known.

    ``before`` is an earlier attempt at the same point, if there was one.
    """
    axis, f, a = point.request.axis, point.frequency_hz, point.request.amplitude_a
    seconds = point.request.blocks * point.request.samples / limits.sample_rate_hz
    largest = largest_amplitude(knowledge, axis, f, aim, limits)
    wanted = min(largest, needed_amplitude(knowledge, axis, f, aim, seconds))
    saturated = visible(point, knowledge, limits.sample_rate_hz) and (
        distortion(point, knowledge, limits.sample_rate_hz) > DISTORTION or compressed(point, before)
    )
    too_large = a > OVERSHOOT * largest
    too_small = WEAKNESS * a < wanted and not saturated
    return Judgement(
        agreement=settled(point, knowledge, aim, limits.sample_rate_hz),
        saturated=saturated,
        too_large=too_large,
        too_small=too_small,
        better_amplitude_a=min(wanted, largest, STEP_UP * a) if too_large or too_small else a / 2,
    )
