"""What a supply's voltage limit changes of the coil currents in a periodic steady state, harmonic by harmonic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim import amplifier, periodic
from sim.alternating import Complex, amplitudes, period_samples, whole_periods, windowed_amplitudes
from sim.rig import Amplifiers, Array, Rig

SLEW_STEPS = 256
"""Fewest time steps of a period in which a second-order amplifier is followed."""
HELD_STEPS, HELD_STEPS_OF_LAG = 8, 16
"""Steps of a sample in which a first-order one is, whose slope jumps with the held signal; with a lag before it."""
NOISE_DEVIATIONS = 4.0
"""Root mean squares of a noise's slopes within which it reaches a limit, but for 6 in 100 000 of the time."""
HELD_PERIODS, HELD_SETTLING, HELD_SAMPLES = 6, 200, 300
"""Fewest periods, and samples, until such an amplifier is steady to some 1e-5, and that are analysed then."""


def second_order(
    amp: Amplifiers, omega: Array, harmonics: tuple[int, ...], asked: Complex, wanted: Complex | None
) -> Complex:
    """Change of the current of second-order amplifiers, (P, H, n).

    Parameters
    ----------
    omega : (P, H) of each harmonic, rad/s
    harmonics : 1 among them
    asked : (P, H, n) slope of the current that the linear amplifier would have, A/s
    wanted : (P, H, n) change that was seen; of the two ways in which an amplifier beyond its limit may answer, the one
        nearer to it, else the one that a rising amplitude leads to
    """
    # i' = v + dv, dv = clip(v) - v, inside the amplifier's own loop; i = A u + N dv with
    # N = (s + 2 zeta w) / (s^2 + 2 zeta w s + w^2), of what of zeta the loop does not see.
    assert amp.damping_ratio is not None
    s, w = 1j * omega[..., None], amp.natural_frequency_rad_s
    damping = 2 * amp.damping_ratio * w
    per_slew = (s + damping * (1 - amp.slew_seen)) / (s**2 + damping * s + w**2)
    dv = np.zeros(asked.shape, dtype=complex)
    reached = amp.slew_limit_a_per_s * (1 - NOISE_DEVIATIONS * amp.slope_noise_share)
    slewing = np.flatnonzero(np.any(np.abs(asked).sum(axis=1) > reached, axis=1))
    if len(slewing):
        fundamental = omega[slewing, harmonics.index(1)]
        dv[slewing] = _taken(amp, fundamental, harmonics, asked[slewing], False)
        if wanted is not None:
            opposed = _taken(amp, fundamental, harmonics, asked[slewing], True)
            change, seen = per_slew[slewing], wanted[slewing]
            misses = [np.abs(seen - change * taken).sum(axis=1, keepdims=True) for taken in (opposed, dv[slewing])]
            dv[slewing] = np.where(misses[0] < misses[1], opposed, dv[slewing])
    return np.asarray(per_slew * dv)


def _taken(amp: Amplifiers, omega: Array, harmonics: tuple[int, ...], asked: Complex, opposed: bool) -> Complex:
    """What the limit takes off the slope of the current, (P, H, n), in the steady state.

    Stepped through time, as it has more harmonics than are asked for and a loop that winds up.
    """
    assert amp.damping_ratio is not None
    w, limit = amp.natural_frequency_rad_s, amp.slew_limit_a_per_s
    finest = (4 if opposed else 1) * SLEW_STEPS  # it is at its limit all the time, and when it turns counts
    steps = int(np.clip(8 * w.max() / omega.min(), finest, 8 * SLEW_STEPS))
    damping = 2 * amp.damping_ratio * w
    over = np.ascontiguousarray(period_samples(asked, harmonics, steps))
    dt, noise = 2 * np.pi / omega / steps, _slope_noise(amp)
    taken = periodic.slewing(over, dt, w, damping, float(amp.slew_seen), limit, opposed, noise)
    return amplitudes(taken, harmonics)


def _slope_noise(amp: Amplifiers) -> Array:
    """Root mean square of the slopes that noise asks of each coil, (n,) A/s; 0 where there is no limit."""
    return amp.slope_noise_share * np.where(np.isfinite(amp.slew_limit_a_per_s), amp.slew_limit_a_per_s, 0.0)


def first_order(rig: Rig, omega: Array, harmonics: tuple[int, ...], U: Complex) -> tuple[Complex, Complex]:
    """Change of the current of first-order amplifiers, at the samples and as it flows, (P, H, n) each.

    Their slope jumps with u as it is held, by more than its sine asks for, and the samples fold the jumps back. So each
    point is stepped through its own samples, whose phases depend on how many of them a period has. What u has beyond
    the harmonics is not known: at 700 Hz it moves the current by 0.06 % where the limit halves it, and by 0.8 % where
    a quarter is left.

    Far beyond its limit an amplifier passes on less of any second signal, and a mode that the loop no longer damps
    swings beside the tone: at 700 Hz, 2.2 A and a delay of 30 us one at 911 Hz with its image at 489 Hz, twice the tone
    less it. The current of the tone alone is then a tenth less than this says; the blocks of such a point scatter.

    Parameters
    ----------
    omega : (P, H) of each harmonic, rad/s
    harmonics : 1 among them
    U : (P, H, n) control signal, A
    """
    amp, period = rig.amplifiers, rig.controller.sample_time_s
    w, asked = amp.natural_frequency_rad_s, amp.gain * (amp.crosstalk @ U[..., None])[..., 0]
    # straight after a sample acts, without a lag: the largest slope there is
    at_once = replace(amp, lag_s=0.0)
    reached = amplifier.sampled(at_once, omega.ravel(), period, np.zeros_like(amp.delay_s)) / amp.gain
    steepest = w * np.abs(asked * (1 - reached.reshape(asked.shape))).sum(axis=1)
    noise = _slope_noise(amp)
    limit = np.where(steepest > amp.slew_limit_a_per_s - NOISE_DEVIATIONS * noise, amp.slew_limit_a_per_s, np.inf)
    delay_s = amp.delay_s + rig.controller.computing_delay_s
    whole = np.floor(delay_s / period + 1e-9)
    late_s = np.maximum(delay_s - whole * period, 0.0)
    steps = HELD_STEPS_OF_LAG if amp.lag_s > 0 else HELD_STEPS
    sampled, flowing, orders = np.zeros_like(U), np.zeros_like(U), np.array(harmonics)
    for p in np.flatnonzero(np.isfinite(limit).any(axis=1)):
        angle = float(omega[p, harmonics.index(1)]) * period
        samples = 2 * np.pi / angle  # of a period
        settling = int(np.ceil(max(HELD_PERIODS * samples, HELD_SETTLING)))
        n = whole_periods(samples, max(HELD_PERIODS * samples, HELD_SAMPLES))
        turns = np.exp(1j * angle * np.outer(np.arange(-settling - 1, n), orders))
        held = (turns @ (asked[p] * np.exp(-1j * angle * np.outer(orders, whole)))).real
        change = periodic.held_slewing(held, period, late_s, amp.lag_s, w, limit[p], steps, noise)
        steady = change.reshape(-1, steps, change.shape[1])[settling:]
        sampled[p], flowing[p] = windowed_amplitudes(steady, angle, orders)
    return sampled, flowing
