"""Whether the rotor's response is modulated, which scatters the blocks and leaves their mean as it is.

Noise does not depend on which plane is driven. So a displacement at one frequency must scatter alike whether its own
plane is excited or the other one. A modulated stiffness multiplies the response, and scatters it in the driven plane.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

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
"""Normal deviate of a sweep's scatter, driven plane against the other, from which the response is modulated. On 50
sweeps of clean rigs of two other programs it was -3.6 to 2.8, with modulated stiffnesses 10 to 47. Some effects scatter
the blocks, too (ringing, limits, quantisation, a log out of step); their means show them, and they are named for
that."""
LATE = 3.0
"""The same deviate of the last half of the blocks, in which transients have decayed."""
LARGEST = 4.0
"""Largest deviate with which one channel counts, so that no single line decides."""
SCATTERS = frozenset({"logging_offset", "magnetic_hysteresis", "touchdown_contact"})
"""Effects that may scatter the blocks of what the rotor answers: a log out of step by 15 deviates, plays by 11 to 18, a
stop by -6 to 32. In 35 experiments saturation, a voltage limit, a rotor off centre and drift did so by 4 at most. A rig
whose twin names one of them scatters for that."""
FEWEST = 5
"""Fewest blocks of a point."""
BEYOND_COMPARE = 100.0
"""Largest ratio of two scatters that is stated as a number."""
CHANNELS = 20
"""Fewest channels times lines."""


def modulated_stiffness(sweeps: Sequence[Sweep], rig: Rig, known: Collection[str] = ()) -> str | None:
    """That the response is modulated in every sweep, in words; None where it is not, or where they cannot show it.

    They cannot where the twin names effects, ``known``, that scatter it as well.
    """
    tested = [scatter_of_answer(s, rig) for s in sweeps if s.in_sequence]
    if not tested or len(tested) < len(sweeps) or not SCATTERS.isdisjoint(known):
        return None
    ratios = [ratio for _, _, ratio in tested]
    if all(z > SWINGS and late > LATE for z, late, _ in tested):
        return (
            "displacements scatter more where their own plane is driven than where the other one is "
            f"({_times(max(ratios))}): what the rotor answers swings from block to block, or had not settled, or noise "
            "alone is too small for the steps of the log"
        )
    if all(z < -SWINGS and late < -LATE for z, late, _ in tested):
        return (
            "displacements scatter less where their own plane is driven than where the other one is "
            f"({_times(1 / min(ratios))}): without a tone they rest in steps or in a gap that a tone bridges"
        )
    return None


def _times(ratio: float) -> str:
    """A ratio of two scatters in words; it is huge where a signal rests within one step of the log.

    >>> _times(2.44), _times(1e140)
    ('up to 2.4 times', 'more than 100 times')
    """
    return f"up to {ratio:.1f} times" if ratio < BEYOND_COMPARE else f"more than {BEYOND_COMPARE:.0f} times"


def scatter_of_answer(sweep: Sweep, rig: Rig) -> tuple[float, float, float]:
    """Scatter of y in the driven plane against that in the other one.

    Parameters
    ----------
    rig
        Any reasonable twin, to take the feedback of noise out of the scatter.

    Returns
    -------
    Normal deviate of all blocks, without a trend along them; that of their last half; ratio of the standard deviations,
    a geometric mean. 0, 0 and 1 where the sweep cannot show it: one plane, few blocks, few lines.
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
    complete = [at for at in lines if len(at) == n and len(set(sweep.axis[at])) == n and not rings[at].any()]
    if n * len(complete) < CHANNELS:
        return 0.0, 0.0, 1.0
    z, ratios = _against_the_other_plane(whole, sweep, complete, 2 * (blocks - 2))
    z_late, _ = _against_the_other_plane(late, sweep, complete, 2 * (blocks // 2 - 1))
    return z, z_late, float(np.sqrt(np.exp(np.mean(np.log(ratios)))))


def _against_the_other_plane(
    power: Real, sweep: Sweep, lines: Sequence[NDArray[np.int64]], dof: int
) -> tuple[float, Real]:
    """F test, as a normal deviate of all channels of all lines together, and each one's ratio of variances.

    ``power`` is the sum of squared deviations, (P, n), of ``dof`` complex degrees of freedom for both points of a
    plane.
    """
    ratios = []
    for at in lines:
        own = sweep.axis[at][:, None] // 2 == np.arange(power.shape[1]) // 2
        of_own, of_other = (np.where(mask, power[at], 0.0).sum(axis=0) for mask in (own, ~own))
        ratios.append(of_own / np.maximum(of_other, np.finfo(float).tiny))
    ratio = np.maximum(np.concatenate(ratios), np.finfo(float).tiny)
    p = f_tail(ratio, 2 * dof, 2 * dof)
    z = np.clip(normal_above(np.clip(p, 1e-15, 1 - 1e-15)), -LARGEST, LARGEST)
    return float(z.sum() / np.sqrt(len(z))), ratio


def _power(e: Complex) -> Real:
    """Sum of squares over the blocks, (P, B, n) -> (P, n)."""
    return np.asarray(np.sum(np.abs(e) ** 2, axis=1))
