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
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.experiment.knowledge import Knowledge
from sim.datasheet import Datasheet

Real = NDArray[np.float64]

MAINS_HZ = (50.0, 60.0)
SMALLEST_A = 1e-5
"""Smallest amplitude of a tone that is asked for: ten steps of the controllers' scale, which moves no rotor."""
CLEARANCE_HZ = 4.0
"""Most that a tone keeps off a line: less than half the distance between the two mains frequencies."""


@dataclass(frozen=True)
class Profile:
    """What an experiment shall reach. The defaults suit a rig of some hundred kilograms sampled at 10 kHz."""

    accuracy: float = 0.002
    """Wanted relative standard deviation of every column of the frequency response, each point."""
    points: int = 200
    """Log-spaced frequencies of the main sweep, each with every axis; peaks come on top."""
    from_hz: float = 10.0
    to_hz: float = 1000.0
    validation_points: int = 50
    validation_gain: float = 2.5
    """Amplitude of the validation sweep against the main one."""
    amplifier_points: int = 50
    amplifier_to_hz: float = 3000.0
    coarse_points: int = 28
    coarse_accuracy: float = 0.02
    blocks: int = 6
    displacement_share: float = 0.1
    """Share of the linear range, and of the displacement limit, that the main sweep may use."""
    current_share: float = 0.25
    """Share of the bias current, and of the current limit, that the main sweep may use."""
    nonlinearity: float = 0.2
    """Share of the accuracy that the cubic terms of the magnets' force may take: displacement over gap squared, and
    displacement over gap times current over bias current."""
    rig_seconds: float = 1000.0
    """Time of the rig that a campaign over four axes should need; others in proportion."""
    peak_points: int = 5
    """Points within the half-power width of a peak that resolve it."""
    tries: int = 5
    """Attempts at one point: longer settling, other amplitudes."""
    frequencies_hz: tuple[float, ...] = ()
    """Frequencies of the main sweep in place of ``points`` log-spaced ones; peaks are then not searched."""
    settle_s: tuple[float, ...] = ()
    """Settling time to begin with at each of ``frequencies_hz``, where a model tells it; () for none."""


@dataclass(frozen=True)
class Limits:
    """What a rig and its controller allow, from the datasheet and the controller's capabilities."""

    n_axes: int
    sample_rate_hz: float
    max_frequency_hz: float
    max_samples: int
    max_amplitude_a: float
    displacement_limit_m: float
    current_limit_a: float
    linear_range_m: float
    bias_current_a: float
    gap_m: float
    """Nominal air gap i0 ki / ks of the datasheet."""

    @staticmethod
    def of(
        datasheet: Datasheet,
        sample_rate_hz: float,
        max_frequency_hz: float,
        max_samples: int,
        max_amplitude_a: float,
        displacement_limit_m: float,
        current_limit_a: float,
    ) -> Limits:
        """Limits of a datasheet together with those that the controller reports; the tighter one holds."""
        gaps = [
            i0 * ki / ks
            for i0, ki, ks in zip(
                datasheet.bias_current_a,
                datasheet.current_stiffness_n_per_a,
                datasheet.position_stiffness_n_per_m,
                strict=True,
            )
        ]
        return Limits(
            n_axes=datasheet.n_axes,
            sample_rate_hz=sample_rate_hz,
            max_frequency_hz=min(max_frequency_hz, 0.45 * sample_rate_hz),
            max_samples=max_samples,
            max_amplitude_a=max_amplitude_a,
            displacement_limit_m=min(displacement_limit_m, datasheet.displacement_limit_m),
            current_limit_a=min(current_limit_a, datasheet.current_limit_a),
            linear_range_m=datasheet.linear_range_m,
            bias_current_a=min(datasheet.bias_current_a),
            gap_m=min(gaps),
        )


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

    def with_amplitude(self, amplitude_a: float) -> Request:
        """The same tone, another amplitude."""
        return replace(self, amplitude_a=amplitude_a)


@dataclass(frozen=True)
class Aim:
    """What a sweep wants of its tones."""

    accuracy: float
    displacement_m: float
    """Largest displacement amplitude of any axis."""
    current_a: float
    """Largest current amplitude of any axis."""
    block_s: float
    """Wanted length of a block; longer when a period is, or when limits cut the amplitude."""
    longest_block_s: float
    cubic: float
    """Largest relative cubic term of the magnets' force."""
    amplifier: bool = False
    """Only u and i matter, not y."""
    gain: float = 1.0
    """Factor on the amplitude that the accuracy asks for."""


def aims(profile: Profile, limits: Limits) -> dict[str, Aim]:
    """Aim of every sweep: "coarse", "main", "validation", "amplifier"."""
    p = profile
    # half of the displacement limit is left for the operating point, noise and the transient of the ramp
    free_y = 0.5 * min(limits.displacement_limit_m, limits.linear_range_m)
    free_i = 0.5 * min(limits.current_limit_a, limits.bias_current_a)
    cubic = p.nonlinearity * p.accuracy
    y = min(
        p.displacement_share * min(limits.displacement_limit_m, limits.linear_range_m), limits.gap_m * math.sqrt(cubic)
    )
    i = p.current_share * min(limits.current_limit_a, limits.bias_current_a)
    # a block of the main sweep: its share of the budget, half of a point's time for settling and ramps
    weight = p.points + 0.5 * (p.validation_points + p.amplifier_points + p.coarse_points) + 12 * p.peak_points
    block = p.rig_seconds / 4 / weight / 2 / p.blocks
    wide = p.validation_gain
    free = wide**2 * cubic
    return {
        "coarse": Aim(p.coarse_accuracy, y, i, block / 2, 2 * block, cubic),
        "main": Aim(p.accuracy, y, i, block, 3 * block, cubic),
        "validation": Aim(p.accuracy, min(wide * y, free_y), min(wide * i, free_i), block, 2 * block, free, gain=wide),
        "amplifier": Aim(p.accuracy, y, i, block / 4, block, cubic, amplifier=True),
    }


def grid(from_hz: float, to_hz: float, n: int) -> Real:
    """``n`` log-spaced frequencies, both ends included."""
    return np.geomspace(from_hz, to_hz, n)


def mains_harmonics(up_to_hz: float) -> Real:
    """Multiples of both mains frequencies, rising."""
    return np.unique(np.concatenate([b * np.arange(1, 2 + int(up_to_hz / b)) for b in MAINS_HZ]))


def off_lines(frequency_hz: Real, resolution_hz: float, lines_hz: Real) -> Real:
    """Frequencies moved off spectral lines, in order and none twice.

    A frequency closer to a line than ``resolution_hz`` (one over the length of a whole record) moves to that
    distance: there the line's leakage into the record is zero. Where lines are so close that their bands overlap it
    moves out of all of them.
    """
    f = np.array(frequency_hz, dtype=float)
    for low, high in _forbidden(lines_hz, resolution_hz):
        inside = (f > low) & (f < high)
        f[inside] = np.where(f[inside] - low <= high - f[inside], low, high)
    return np.unique(f)


def _forbidden(lines_hz: Real, resolution_hz: float) -> list[tuple[float, float]]:
    """Bands round lines, those that overlap joined, rising."""
    bands: list[tuple[float, float]] = []
    for line in np.sort(lines_hz):
        low, high = float(line - resolution_hz), float(line + resolution_hz)
        if bands and low < bands[-1][1]:
            bands[-1] = (bands[-1][0], max(high, bands[-1][1]))
        else:
            bands.append((low, high))
    return bands


def clear_grid(from_hz: float, to_hz: float, n: int, resolution_hz: float, lines_hz: tuple[float, ...]) -> Real:
    """``n`` frequencies, log-spaced but for spectral lines (mains, and those of the noise record).

    What was moved onto its neighbour is put where the widest gaps are instead.
    """
    lines = np.unique(np.concatenate([mains_harmonics(to_hz), np.array(lines_hz, dtype=float)]))
    step = (to_hz / from_hz) ** (1 / max(1, n - 1))
    moved = off_lines(grid(from_hz, to_hz, n), resolution_hz, lines)
    moved = moved[(moved >= from_hz) & (moved <= to_hz)]
    kept = moved[np.concatenate([[True], np.diff(np.log(moved)) > np.log(step) / 3])]
    gaps = list(pairwise(kept))
    while len(kept) < n and gaps:
        gaps.sort(key=lambda g: g[1] / g[0])
        low, high = gaps.pop()
        middle = math.sqrt(low * high)
        if np.min(np.abs(lines - middle)) >= resolution_hz:
            kept = np.append(kept, middle)
            gaps += [(low, middle), (middle, high)]
    return np.sort(kept)


def whole_periods(
    frequency_hz: float, block_s: float, sample_rate_hz: float, tolerance_hz: float = np.inf
) -> tuple[int, int]:
    """Periods and samples of a block of about ``block_s`` whose frequency is periods * rate / samples.

    The block is the shortest, not shorter than ``block_s``, that comes within ``tolerance_hz``, or, where none up to
    half as long again (and at least thirty periods more) does, the one that comes nearest. Without a tolerance it is
    the shortest.

    >>> whole_periods(100.0, 0.05, 10_000.0)
    (5, 500)
    """
    first = max(1, math.ceil(frequency_hz * block_s - 1e-9))
    last = max(first + 30, int(1.5 * first))
    best, best_error = (first, 0), np.inf
    for periods in range(first, last + 1):
        samples = max(2, round(periods * sample_rate_hz / frequency_hz))
        error = abs(periods * sample_rate_hz / samples - frequency_hz)
        if error < best_error - 1e-12:
            best, best_error = (periods, samples), error
        if error <= tolerance_hz:
            break
    return best


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
        0.5 * knowledge.slew_a_per_s / (2 * math.pi * frequency_hz * max(response.i_excited, 1e-300)),
        aim.current_a,
        limits.max_amplitude_a,
    )


def block_length_s(knowledge: Knowledge, frequency_hz: float, aim: Aim, profile: Profile, limits: Limits) -> float:
    """Length of a block, s, the same for every axis of a frequency: longer where limits cut an amplitude."""
    block = max(aim.block_s, 1.0 / frequency_hz)
    for axis in range(limits.n_axes):
        if knowledge.knows(axis):
            cap = largest_amplitude(knowledge, axis, frequency_hz, aim, limits)
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
        return min(first, aim.current_a / 20, limits.max_amplitude_a)
    wanted = needed_amplitude(knowledge, axis, frequency_hz, aim, seconds)
    return max(min(wanted, largest_amplitude(knowledge, axis, frequency_hz, aim, limits)), SMALLEST_A)


def tones(
    knowledge: Knowledge,
    frequency_hz: float,
    aim: Aim,
    profile: Profile,
    limits: Limits,
    tolerance_hz: float = np.inf,
) -> list[Request]:
    """One tone for each axis at the same frequency, settled for as long as its neighbours needed.

    All axes share periods and samples, so that their columns make one matrix at one frequency.
    """
    rate = limits.sample_rate_hz
    periods, samples = whole_periods(
        frequency_hz, block_length_s(knowledge, frequency_hz, aim, profile, limits), rate, tolerance_hz
    )
    frequency = periods * rate / samples
    seconds = profile.blocks * samples / rate
    return [
        Request(
            axis=axis,
            amplitude_a=amplitude(knowledge, axis, frequency, aim, seconds, limits),
            periods=periods,
            samples=samples,
            blocks=profile.blocks,
            settle_samples=math.ceil(max(knowledge.settle_s(axis, frequency), 1.0 / frequency) * rate),
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
    return request.with_amplitude(usual / profile.validation_gain)


def resolution_hz(profile: Profile, aim: Aim) -> float:
    """One over the length of a whole record: the distance at which a line leaks nothing into it."""
    return min(1 / (profile.blocks * aim.block_s), CLEARANCE_HZ)


def main_grid(profile: Profile, limits: Limits, aim: Aim, lines_hz: tuple[float, ...]) -> Real:
    """Frequencies of the main sweep before peaks are known."""
    to = min(profile.to_hz, limits.max_frequency_hz)
    if profile.frequencies_hz:
        given = np.unique(np.array(profile.frequencies_hz, dtype=float))
        return given[given <= limits.max_frequency_hz]
    return clear_grid(profile.from_hz, to, profile.points, resolution_hz(profile, aim), lines_hz)


def amplifier_grid(profile: Profile, limits: Limits, aim: Aim, lines_hz: tuple[float, ...]) -> Real:
    """Frequencies of the amplifier sweep: up to 3 kHz, or what the controller can do."""
    to = min(profile.amplifier_to_hz, limits.max_frequency_hz)
    return clear_grid(profile.from_hz, to, profile.amplifier_points, resolution_hz(profile, aim), lines_hz)


def validation_grid(profile: Profile, aim: Aim, measured_hz: Real, lines_hz: tuple[float, ...]) -> Real:
    """Frequencies between those of the main sweep, spread over its whole length, peaks included.

    Gaps of the measured frequencies are halved, evenly chosen by number, so that where the main sweep is dense this
    one is too.
    """
    f = np.unique(measured_hz)
    middle = np.sqrt(f[1:] * f[:-1])
    n = min(profile.validation_points, len(middle))
    chosen = np.unique(np.round(np.linspace(0, len(middle) - 1, n)).astype(int))
    lines = np.unique(np.concatenate([mains_harmonics(f[-1]), np.array(lines_hz, dtype=float)]))
    return off_lines(middle[chosen], resolution_hz(profile, aim), lines)
