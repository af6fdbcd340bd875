"""Change of the coil currents by the supply's voltage limit (a slew limit) in a periodic steady state, by harmonic."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sim import amplifier, periodic
from sim.alternating import Complex, Record, amplitudes, period_samples, whole_periods
from sim.rig import Amplifiers, Array, Rig

Mask = NDArray[np.bool_]

SLEW_STEPS = 256
"""Fewest time steps per period of a second-order amplifier."""
HELD_STEPS, HELD_STEPS_OF_LAG = 8, 16
"""Time steps per sample of a first-order amplifier, whose slope jumps with the held signal; with a lag before it."""
NOISE_DEVIATIONS = 4.0
"""Standard deviations of noise in the slope within which it reaches a limit, but for 6e-5 of the time."""
HELD_PERIODS, HELD_SAMPLES, HELD_SEARCHED = 2, 600, 100
"""Fewest periods and samples of such an amplifier that are analysed: a Hann window parts harmonics over two periods,
and so many samples meet a jump at all its places in a period. Of so many more the number nearest to whole periods."""
SETTLING_PERIODS, SETTLING_SAMPLES = 6, 200
"""Periods, and fewest samples, in which it is steady to some 1e-5 even where it is almost always at its limit."""
GENTLE = 0.1
"""Slope, relative to that of noise, below which a limit that noise alone reaches is linear to 1e-4 of the current."""


def second_order(
    amp: Amplifiers, omega: Array, harmonics: tuple[int, ...], asked: Complex, wanted: Complex | None
) -> Complex:
    """Change of the current of second-order amplifiers, (P, H, n).

    Parameters
    ----------
    omega : (P, H) of each harmonic, rad/s
    harmonics : 1 among them
    asked : (P, H, n) slope of the current that the linear amplifier would have, A/s
    wanted : (P, H, n) measured change; of the two steady states of an amplifier beyond its limit, the one nearer to it
        is returned, without it the one that a rising amplitude leads to
    """
    # i' = v + dv with dv = clip(v) - v inside the amplifier's own loop, so that i = A u + N dv with
    # N = (s + 2 zeta w) / (s^2 + 2 zeta w s + w^2). In the numerator zeta is the share that does not act on the limited
    # slope.
    assert amp.damping_ratio is not None
    s, w = 1j * omega[..., None], amp.natural_frequency_rad_s
    damping = 2 * amp.damping_ratio * w
    per_slew = (s + damping * (1 - amp.slew_seen)) / (s**2 + damping * s + w**2)
    dv = np.zeros(asked.shape, dtype=complex)
    steepest, limit = np.abs(asked).sum(axis=1), amp.slew_limit_a_per_s
    slewing = steepest > limit * (1 - NOISE_DEVIATIONS * amp.slope_noise_share)
    points = np.flatnonzero(slewing.any(axis=1))
    if len(points):
        fundamental = omega[:, harmonics.index(1)]
        dv[points] = _slope_change(amp, fundamental[points], harmonics, asked[points], slewing[points], False)
    # below the limit, or where the loop does not see it, there is one state
    beyond = (steepest > limit) & (amp.slew_seen > 0)
    points = np.flatnonzero(beyond.any(axis=1))
    if len(points) and wanted is not None:
        opposed = _slope_change(amp, fundamental[points], harmonics, asked[points], beyond[points], True)
        change, seen, near = per_slew[points], wanted[points], dv[points]
        misses = [np.abs(seen - change * taken).sum(axis=1) for taken in (opposed, near)]
        dv[points] = np.where((beyond[points] & (misses[0] < misses[1]))[:, None], opposed, near)
    return np.asarray(per_slew * dv)


def _slope_change(
    amp: Amplifiers, omega: Array, harmonics: tuple[int, ...], asked: Complex, reached: Mask, opposed: bool
) -> Complex:
    """Change of the current's slope by the limit, (P, H, n), in the steady state; ``opposed`` selects which of two.

    It is zero where the limit is not ``reached``, (P, n). It is simulated in time, as it has more harmonics than asked
    for, and the amplifier's loop winds up.
    """
    assert amp.damping_ratio is not None
    w, limit = amp.natural_frequency_rad_s, amp.slew_limit_a_per_s
    finest = (4 if opposed else 1) * SLEW_STEPS  # always at its limit, so that the time of each reversal matters
    steps = int(np.clip(8 * w.max() / omega.min(), finest, 8 * SLEW_STEPS))
    damping = 2 * amp.damping_ratio * w
    over = np.ascontiguousarray(period_samples(asked, harmonics, steps))
    dt, noise = 2 * np.pi / omega / steps, _slope_noise(amp)
    taken = periodic.slewing(over, dt, w, damping, float(amp.slew_seen), limit, opposed, noise, reached)
    return amplitudes(taken, harmonics)


def _slope_noise(amp: Amplifiers) -> Array:
    """Root mean square of the slopes that noise asks of each coil, (n,) A/s; 0 where there is no limit."""
    return amp.slope_noise_share * np.where(np.isfinite(amp.slew_limit_a_per_s), amp.slew_limit_a_per_s, 0.0)


def first_order(rig: Rig, omega: Array, harmonics: tuple[int, ...], U: Complex) -> tuple[Complex, Complex]:
    """Change of the current of first-order amplifiers, as sampled and in continuous time, (P, H, n) each.

    Their slope jumps with each step of the held u, by more than the slope of its sine, and sampling aliases the jumps.
    So each point is simulated through its own samples, whose phases depend on their number per period. Neglected are:

    - what u has beyond the harmonics: at 700 Hz it changes the current by 0.06 % where the limit halves it, and by
      0.8 % where a quarter is left;
    - oscillations beside the tone. Far beyond its limit an amplifier passes on less of any second signal, and a mode
      may lose its damping: at 700 Hz, 2.2 A and a delay of 30 us one oscillates at 911 Hz, with an image at 489 Hz,
      twice the tone less it. The current of the tone is then a tenth less than computed; the blocks of such a point
      scatter.

    Parameters
    ----------
    omega : (P, H) of each harmonic, rad/s
    harmonics : 1 among them
    U : (P, H, n) control signal, A
    """
    amp, period = rig.amplifiers, rig.controller.sample_time_s
    w, asked = amp.natural_frequency_rad_s, amp.gain * (amp.crosstalk @ U[..., None])[..., 0]
    # the largest slope is that straight after a sample has changed, without a lag
    without_lag = replace(amp, lag_s=0.0)
    reached = amplifier.sampled(without_lag, omega.ravel(), period, np.zeros_like(amp.delay_s)) / amp.gain
    steepest = w * np.abs(asked * (1 - reached.reshape(asked.shape))).sum(axis=1)
    noise = _slope_noise(amp)
    limit = np.where(steepest > amp.slew_limit_a_per_s - NOISE_DEVIATIONS * noise, amp.slew_limit_a_per_s, np.inf)
    delay_s = amp.delay_s + rig.controller.computing_delay_s
    whole = np.floor(delay_s / period + 1e-9)
    late_s = np.maximum(delay_s - whole * period, 0.0)
    steps = HELD_STEPS_OF_LAG if amp.lag_s > 0 else HELD_STEPS
    sampled, flowing, orders = np.zeros_like(U), np.zeros_like(U), np.array(harmonics)
    gentle = np.isfinite(limit) & (steepest < GENTLE * noise)
    limit = np.where(gentle, np.inf, limit)
    for p in np.flatnonzero(np.isfinite(limit).any(axis=1)):
        angle = float(omega[p, harmonics.index(1)]) * period
        samples = 2 * np.pi / angle  # of a period
        settling = math.ceil(max(SETTLING_PERIODS * samples, SETTLING_SAMPLES))
        n = whole_periods(samples, max(HELD_PERIODS * samples, HELD_SAMPLES), HELD_SAMPLES + HELD_SEARCHED)
        record = Record.of(angle, harmonics, settling + 1, n)
        held = record.samples(asked[p] * np.exp(-1j * angle * np.outer(orders, whole)))
        change = periodic.held_slewing(held, settling, period, late_s, amp.lag_s, w, limit[p], steps, noise)
        sampled[p], flowing[p] = record.amplitudes(change.reshape(n, steps, -1))
    if gentle.any():
        slower = _slowed_by_noise(amp)
        lines, shape = omega.ravel(), (*omega.shape, len(w))
        at_samples = [amplifier.sampled(of, lines, period, delay_s).reshape(shape) for of in (amp, slower)]
        within = [amplifier.continuous(of, lines).reshape(shape) for of in (amp, slower)]
        hold = amplifier.hold(lines, period).reshape(omega.shape)[..., None]
        late = np.exp(-1j * omega[..., None] * delay_s)
        driven = np.where(gentle[:, None], asked / amp.gain, 0.0)
        sampled += (at_samples[1] - at_samples[0]) * driven
        flowing += (within[1] - within[0]) * hold * late * driven
    return sampled, flowing


def _slowed_by_noise(amp: Amplifiers) -> Amplifiers:
    """First-order amplifiers that pass on as much of a small slope as a limit lets through that noise reaches.

    That share is the chance not to be at the limit (Booton, IRE Trans. Circuit Theory 1, 1954, pp. 9-18).
    """
    with np.errstate(divide="ignore"):
        share = special.erf(1 / (np.sqrt(2) * np.asarray(amp.slope_noise_share)))
    return replace(amp, natural_frequency_rad_s=amp.natural_frequency_rad_s * share)
