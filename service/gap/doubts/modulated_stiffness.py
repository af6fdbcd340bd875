"""Whether what a rotor answers swings: a stiffness that is modulated leaves the means of blocks as they were.

Noise does not know which plane is driven. So the same signals at the same frequency scatter alike whether their own
plane is excited or the other one; what multiplies the answer scatters only where there is one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.distributions import f_tail, normal_above
from service.experiment.data import Sweep
from service.gap.measured.observation import ringing
from service.gap.measured.scatter import unexplained
from service.gap.measured.settling import about_trend
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

SWINGS = 6.0
"""Normal deviate of a sweep's scatter, own plane against the other, from which it swings. On 50 sweeps of clean rigs of
two other programs it was -3.6 to 2.8, of swinging stiffnesses 10 to 47. Effects that the means show may scatter too,
what rings, what limits or quantises, and a log out of step; they are named for what their means show."""
LATE = 3.0
"""The same of the last half of the blocks alone: the rest of a transient has decayed by then."""
LARGEST = 4.0
"""Normal deviate that one channel counts with at most, so that no single line decides."""
FEWEST = 5
"""Blocks of a point from which their scatter tells enough."""
BEYOND_COMPARE = 100.0
"""Ratio of two scatters that is told as it is up to here."""
CHANNELS = 20
"""Channels times lines from which a sweep tells enough."""


def modulated_stiffness(sweeps: Sequence[Sweep], rig: Rig) -> str | None:
    """That the answer swings in every sweep, in words; None where it does not or where they cannot tell."""
    told = [scatter_of_answer(s, rig) for s in sweeps if s.in_sequence]
    if not told or len(told) < len(sweeps):
        return None
    ratios = [ratio for _, _, ratio in told]
    if all(z > SWINGS and late > LATE for z, late, _ in told):
        return (
            "displacements scatter more where their own plane is driven than where the other one is "
            f"({_times(max(ratios))}): what the rotor answers swings from block to block, or had not settled, or noise "
            "alone is too small for the steps of the log"
        )
    if all(z < -SWINGS and late < -LATE for z, late, _ in told):
        return (
            "displacements scatter less where their own plane is driven than where the other one is "
            f"({_times(1 / min(ratios))}): without a tone they rest in steps or in a gap that a tone bridges"
        )
    return None


def _times(ratio: float) -> str:
    """A ratio of two scatters in words: where a signal rests in a step of the log it has none.

    >>> _times(2.44), _times(1e140)
    ('up to 2.4 times', 'more than 100 times')
    """
    return f"up to {ratio:.1f} times" if ratio < BEYOND_COMPARE else f"more than {BEYOND_COMPARE:.0f} times"


def scatter_of_answer(sweep: Sweep, rig: Rig) -> tuple[float, float, float]:
    """The scatter of y in the driven plane against that in the other one.

    Parameters
    ----------
    rig
        Any reasonable twin, to take out what feedback carries round.

    Returns
    -------
    Normal deviate of all blocks, a trend along them taken off; that of the last half of them; ratio of the standard
    deviations, a geometric mean. 0, 0 and 1 where the sweep cannot tell: one plane, few blocks, few lines.
    """
    blocks, n = sweep.Y.shape[1], sweep.Y.shape[2]
    if n != 4 or blocks < FEWEST:
        return 0.0, 0.0, 1.0
    h = sweep.harmonics.index(1)
    e = unexplained(sweep, rig)[2][:, :, h]
    last = e[:, blocks - blocks // 2 :]
    whole, late = _power(about_trend(e)[0]), _power(last - last.mean(axis=1, keepdims=True))
    rings = ringing(rig, sweep)[:, h]
    lines = [np.flatnonzero(sweep.frequency_hz == f) for f in np.unique(sweep.frequency_hz)]
    told = [at for at in lines if len(at) == n and len(set(sweep.axis[at])) == n and not rings[at].any()]
    if n * len(told) < CHANNELS:
        return 0.0, 0.0, 1.0
    z, ratios = _against_the_other_plane(whole, sweep, told, 2 * (blocks - 2))
    z_late, _ = _against_the_other_plane(late, sweep, told, 2 * (blocks // 2 - 1))
    return z, z_late, float(np.sqrt(np.exp(np.mean(np.log(ratios)))))


def _against_the_other_plane(
    power: Real, sweep: Sweep, lines: Sequence[NDArray[np.int64]], freedom: int
) -> tuple[float, Real]:
    """Normal deviate of all channels together, and each one's ratio of variances; ``power`` is (P, n)."""
    ratios = []
    for at in lines:
        own = sweep.axis[at][:, None] // 2 == np.arange(power.shape[1]) // 2
        of_own, of_other = (np.where(mask, power[at], 0.0).sum(axis=0) for mask in (own, ~own))
        ratios.append(of_own / np.maximum(of_other, np.finfo(float).tiny))
    ratio = np.maximum(np.concatenate(ratios), np.finfo(float).tiny)
    # two points on either side, each with as many complex dimensions
    above = f_tail(ratio, 2 * freedom, 2 * freedom)
    z = np.clip(normal_above(np.clip(above, 1e-15, 1 - 1e-15)), -LARGEST, LARGEST)
    return float(z.sum() / np.sqrt(len(z))), ratio


def _power(e: Complex) -> Real:
    return np.asarray(np.sum(np.abs(e) ** 2, axis=1))
