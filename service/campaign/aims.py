"""What an experiment shall reach, and what rig and controller allow: every figure of the plan follows from these."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim.datasheet import Datasheet

STEPS_PER_A = 1_000_000
"""A controller plays whole microamperes, and no map carries finer steps; a tone is planned as it is played."""


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
    amplitude_steps_per_a: int = STEPS_PER_A
    """Amplitudes are whole multiples of one over that, A."""

    @staticmethod
    def of(
        datasheet: Datasheet,
        sample_rate_hz: float,
        max_frequency_hz: float,
        max_samples: int,
        max_amplitude_a: float,
        displacement_limit_m: float,
        current_limit_a: float,
        amplitude_steps_per_a: int = STEPS_PER_A,
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
            amplitude_steps_per_a=amplitude_steps_per_a,
        )


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
