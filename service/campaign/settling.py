"""Is a point at steady state? Its blocks say so, or not; and how much longer to wait when not.

Blocks of a settled point scatter about one value by their noise. A transient makes them drift: it decays
geometrically from block to block, so it is largest in the first ones. The noise is known from the preliminary step;
where excitation itself makes more of it (a longer wait does not lower the scatter), that scatter is the noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

FALSE_ALARM = 1e-2
"""Share of settled points that the test may call drifting by chance; each costs one repetition."""


@dataclass(frozen=True)
class Agreement:
    """How well the blocks of a point agree."""

    excess: float
    """Scatter over noise, as a ratio of standard deviations; about 1 when only noise is left."""
    drift: float
    """First half against second half, in standard deviations of that difference, root mean square of the channels."""
    settled: bool


def agreement(blocks: Complex, variance: Real, negligible: Real) -> Agreement:
    """Whether blocks agree within their noise.

    Parameters
    ----------
    blocks
        (B, n) complex amplitudes of n channels.
    variance
        (n,) noise variance E|X|^2 of one block.
    negligible
        (n,) a change that does not matter, whatever the noise: it is added to the standard deviation.

    Returns
    -------
    agreement
        Settled when both the whole scatter and the drift between the halves are what noise explains at
        `FALSE_ALARM`.
    """
    n_blocks, n = blocks.shape
    allowed = variance + negligible**2
    deviation = blocks - blocks.mean(axis=0)
    total = float(np.sum(np.abs(deviation) ** 2 / allowed))
    half = n_blocks // 2
    halves = blocks[-half:].mean(axis=0) - blocks[:half].mean(axis=0)
    drift = float(np.sum(np.abs(halves) ** 2 / (allowed * 2 / half)))
    # 2 |X|^2 / variance of a complex Gaussian is chi-square with two degrees of freedom
    settled = 2 * total < _chi_square_limit(2 * (n_blocks - 1) * n) and 2 * drift < _chi_square_limit(2 * n)
    return Agreement(
        excess=float(np.sqrt(total / ((n_blocks - 1) * n))), drift=float(np.sqrt(drift / n)), settled=bool(settled)
    )


def _chi_square_limit(freedom: int) -> float:
    """What a chi-square variable exceeds by chance in half of `FALSE_ALARM`: two tests share it."""
    return float(2 * gammainccinv(freedom / 2, FALSE_ALARM / 2))


def period_change(first: Complex, last: Complex, variance: Real, negligible: Real) -> float:
    """How much a multisine's lines still change from the first period to the last, over what chance allows.

    Parameters
    ----------
    first, last
        (L, n) amplitudes at L lines of n axes.
    variance
        (L, n) noise variance E|X|^2 of one period.
    negligible
        (L,) a change that does not matter, whatever the noise.

    Returns
    -------
    ratio
        Of the line that changes most: its power of change over the limit that noise alone exceeds at any of the lines
        with `FALSE_ALARM`. Above 1 a transient is not over.
    """
    n_lines, n = first.shape
    power = np.sum(np.abs(last - first) ** 2 / (2 * variance + negligible[:, None] ** 2), axis=1)
    limit = float(gammainccinv(n, FALSE_ALARM / n_lines))  # a sum of n exponential variables
    return float(np.max(power) / limit)


def stationary(before: Agreement, after: Agreement) -> bool:
    """Whether a longer wait did not help: what scatters is noise or interference that excitation brings, no transient.

    A transient would have decayed; three tenths are what chance can hide.
    """
    return after.excess > 0.7 * before.excess and after.drift > 0.7 * before.drift


def tolerable(now: Agreement) -> bool:
    """Whether a scatter that waiting does not lower is still about what the noise at rest explains."""
    return now.excess < 2.0 and now.drift < 4.0


def longer(waited_s: float, now: Agreement, block_s: float, before: tuple[float, Agreement] | None) -> float:
    """Settling time to try next, s.

    With two attempts the transient's decay is known, and the time follows at which it will have sunk below the
    noise; with one, the time is doubled. Between one block more and four times as long.
    """
    guess = 2 * waited_s
    if before is not None:
        earlier_s, earlier = before
        size_now, size_before = max(now.excess, now.drift), max(earlier.excess, earlier.drift)
        if size_now < size_before:
            time_constant = (waited_s - earlier_s) / np.log(size_before / size_now)
            guess = waited_s + time_constant * np.log(max(2.0, 2 * size_now))
    return float(np.clip(guess, waited_s + block_s, max(4 * waited_s, waited_s + 2 * block_s)))
