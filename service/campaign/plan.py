"""Which tones, how large and how long: pure, from what has been measured so far.

The aim is stated (`Profile`: a relative accuracy of the frequency response, a share of the linear range, a budget of
rig time); every figure of a tone follows from it and from measurements. The amplitude is the thesis's equation 3.18
for one tone at a time: a sine of amplitude a that is measured for T seconds gives a column of G = Y U^-1 the relative
accuracy n / (a sqrt(T)), where n^2 is the noise density over the squared response, so constant accuracy asks for
a^2 proportional to Phi_v / |G|^2. Limits cut the amplitude, and then time makes up for it.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from service.campaign.aims import STEPS_PER_A, Aim, Limits, Profile
from service.campaign.frequencies import whole_periods
from service.campaign.knowledge import Knowledge

SMALLEST_A = 1e-5
"""Smallest amplitude of a tone that is asked for: ten steps of the controllers' scale, which moves no rotor."""
FOLLOWED_SHARE = 0.02
"""Share of an aim's current that any supply lets an amplifier follow: a current that is distorted although it is so
small is so for another reason, as where a loop that is hardly damped still rings."""


@dataclass(frozen=True)
class Request:
    """One tone as the plan wants it; `drivers.controller.Tone` without the driver."""

    axis: int
    amplitude_a: float
    periods: int
    samples: int
    blocks: int
    settle_samples: int
    raw: bool = False

    def frequency_hz(self, sample_rate_hz: float) -> float:
        """Excited frequency, Hz."""
        return self.periods * sample_rate_hz / self.samples

    def seconds(self, sample_rate_hz: float) -> float:
        """Time that the rig will need, without the controller's ramps."""
        return (self.settle_samples + self.blocks * self.samples) / sample_rate_hz

    def description(self) -> dict[str, Any]:
        """What a journal keeps, to know the same question again."""
        return asdict(self)

    def recalled(self, kept: Any) -> Request | None:
        """The tone of a journal where it is this one but for the last digits of a processor; None where it is another.

        Those digits, rounded up here and down there, are a step of the amplitude or a sample of the settling.
        """
        asked = self.description()
        if not isinstance(kept, dict) or kept.keys() != asked.keys():
            return None
        given = {"amplitude_a", "settle_samples"}
        if any(kept[name] != asked[name] for name in asked.keys() - given):
            return None
        found = Request(**kept)
        near = abs(found.amplitude_a - self.amplitude_a) <= 1.5 / STEPS_PER_A
        near &= abs(found.settle_samples - self.settle_samples) <= 1
        return found if near and (found.amplitude_a > 0) == (self.amplitude_a > 0) else None

    def with_amplitude(self, amplitude_a: float, steps_per_a: int = STEPS_PER_A) -> Request:
        """The same tone, another amplitude."""
        return replace(self, amplitude_a=settable(amplitude_a, steps_per_a))


def settable(amplitude_a: float, steps_per_a: int = STEPS_PER_A) -> float:
    """The largest amplitude that a controller can play within a wanted one, A; never none where one is wanted.

    >>> settable(0.1234567), settable(0.3), settable(2e-8), settable(0.0), settable(0.1239, 1000)
    (0.123456, 0.3, 1e-06, 0.0, 0.123)
    """
    if amplitude_a <= 0:
        return 0.0
    steps = round(amplitude_a * steps_per_a)
    return max(steps - int(steps / steps_per_a > amplitude_a), 1) / steps_per_a


def needed_amplitude(knowledge: Knowledge, axis: int, frequency_hz: float, aim: Aim, seconds: float) -> float:
    """Amplitude, A, that reaches the aim's accuracy in ``seconds`` of measurement: eq. 3.18."""
    noise = knowledge.noise_at_unit(axis, frequency_hz, aim.amplifier)
    return aim.gain * noise / (aim.accuracy * math.sqrt(seconds))


def largest_amplitude(knowledge: Knowledge, axis: int, frequency_hz: float, aim: Aim, limits: Limits) -> float:
    """Amplitude, A, at which the aim's displacement or current, or the controller's limit, is reached."""
    response = knowledge.response(axis, frequency_hz)
    caution = knowledge.caution(axis)
    return min(
        caution * aim.displacement_m / max(response.y, 1e-300),
        caution * aim.current_a / max(response.i, 1e-300),
        caution * math.sqrt(aim.cubic * limits.bias_current_a * limits.gap_m / max(response.i_times_y, 1e-300)),
        max(0.5 * knowledge.slew_a_per_s / (2 * math.pi * frequency_hz), FOLLOWED_SHARE * aim.current_a)
        / max(response.i_excited, 1e-300),
        aim.current_a,
        limits.max_amplitude_a,
    )


def block_length_s(knowledge: Knowledge, frequency_hz: float, aim: Aim, profile: Profile, limits: Limits) -> float:
    """Length of a block, s, the same for every axis of a frequency: longer where limits cut an amplitude."""
    block = max(aim.block_s, 1.0 / frequency_hz)
    for axis in range(limits.n_axes):
        if knowledge.knows(axis):
            cap = max(largest_amplitude(knowledge, axis, frequency_hz, aim, limits), SMALLEST_A)
            wanted = needed_amplitude(knowledge, axis, frequency_hz, aim, 1.0) / aim.gain
            block = max(block, min((wanted / cap) ** 2 / profile.blocks, aim.longest_block_s))
    return block


def amplitude(knowledge: Knowledge, axis: int, frequency_hz: float, aim: Aim, seconds: float, limits: Limits) -> float:
    """Amplitude, A, of a tone that is measured for ``seconds``: eq. 3.18 within the limits.

    Where nothing is known of the axis yet, the excitation is assumed to pass to the current unchanged, and a
    twentieth of the current's share is the most.
    """
    if not knowledge.knows(axis):
        density = knowledge.noise.block_variance(frequency_hz, seconds)
        first = math.sqrt(float(density["i"][axis] + density["u"][axis])) / aim.accuracy
        found = min(first, aim.current_a / 20, limits.max_amplitude_a)
        return settable(max(found, SMALLEST_A), limits.amplitude_steps_per_a)
    wanted = needed_amplitude(knowledge, axis, frequency_hz, aim, seconds)
    found = min(wanted, largest_amplitude(knowledge, axis, frequency_hz, aim, limits))
    return settable(max(found, SMALLEST_A), limits.amplitude_steps_per_a)


def tones(
    knowledge: Knowledge,
    frequency_hz: float,
    aim: Aim,
    profile: Profile,
    limits: Limits,
    tolerance_hz: float = np.inf,
) -> list[Request]:
    """One tone for each axis at the same frequency, settled for as long as its neighbours needed.

    All axes share periods and samples, so that their columns make one matrix at one frequency. Record and settling are
    no longer than the controller takes.
    """
    rate = limits.sample_rate_hz
    periods, samples = whole_periods(
        frequency_hz,
        block_length_s(knowledge, frequency_hz, aim, profile, limits),
        rate,
        tolerance_hz,
        limits.max_frequency_hz,
        (limits.max_samples - math.ceil(rate / frequency_hz)) / profile.blocks,
    )
    frequency = periods * rate / samples
    seconds = profile.blocks * samples / rate
    longest = max(limits.max_samples - profile.blocks * samples, 0)
    return [
        Request(
            axis=axis,
            amplitude_a=amplitude(knowledge, axis, frequency, aim, seconds, limits),
            periods=periods,
            samples=samples,
            blocks=profile.blocks,
            settle_samples=min(math.ceil(max(knowledge.settle_s(axis, frequency), 1.0 / frequency) * rate), longest),
        )
        for axis in range(limits.n_axes)
    ]


def longest_settling(request: Request, limits: Limits, wanted_s: float) -> int:
    """Samples of settling for a wanted time: at most what the controller takes, and twenty times the record."""
    record = request.blocks * request.samples
    return min(math.ceil(wanted_s * limits.sample_rate_hz), limits.max_samples - record, 20 * record)


def other_amplitude(
    request: Request, knowledge: Knowledge, aims_by_name: dict[str, Aim], profile: Profile, limits: Limits
) -> Request:
    """A validation tone whose amplitude differs from the main sweep's, downwards where limits leave no room above."""
    rate = limits.sample_rate_hz
    seconds = request.blocks * request.samples / rate
    usual = amplitude(knowledge, request.axis, request.frequency_hz(rate), aims_by_name["main"], seconds, limits)
    if request.amplitude_a >= 1.3 * usual:
        return request
    return request.with_amplitude(usual / profile.validation_gain, limits.amplitude_steps_per_a)
