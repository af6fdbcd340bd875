"""Channels that tell nothing: a sensor, or a channel of the log, that does not answer to what is excited."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Complex, Sweep
from sim.errors import AmbError

SAME = 1e-15
"""Fundamentals, A or m, no further apart are one number: a constant leaves that much in a lock-in's rounding."""
FEWEST = 3
"""Points that two signals do not have alike by chance."""
NOISE = 3.0
"""Power of the mean over that which the blocks' scatter gives it, 1 of noise alone, below which half of the points are
of a channel that hears nothing."""


def require_live_channels(sweep: Sweep, axes: tuple[str, ...], name: str) -> None:
    """Refuse a sweep in which u, i or y of an axis does not answer to the axis's own excitation.

    Fits of such data end anywhere, after minutes. A channel that reads zero at some of the points is no dead one.

    Raises
    ------
    AmbError
        Names the channel and what it reads.
    """
    if 1 not in sweep.harmonics:
        return
    h = sweep.harmonic(1)
    for k, axis in enumerate(axes):
        own = (sweep.axis == k) & (sweep.amplitude_a > 0)
        for signal, blocks in (("u", sweep.U), ("i", sweep.I), ("y", sweep.Y)):
            if blocks is None or own.sum() < FEWEST:
                continue
            unit, what = ("m", "the sensor") if signal == "y" else ("A", "its measurement")
            if reads := _dead(blocks[own, :, h, k], unit):
                if (other := _swapped_with(sweep, blocks[:, :, h], k)) is not None:
                    raise AmbError(
                        f"{name}: {signal} of {axis} answers to what excites {axes[other]}, and {signal} of "
                        f"{axes[other]} to what excites {axis}: these channels are swapped; swap them back in the log"
                    )
                rest = ", or leave i out of the file" if signal == "i" else ""
                raise AmbError(
                    f"{name}: {signal} of {axis} {reads} at the {int(own.sum())} points that excite {axis}: {what} or "
                    f"the channel of the log is dead; mend it and measure again{rest}"
                )


def dropped(sweep: Sweep) -> NDArray[np.bool_]:
    """Points at which u, i and y of the excited axis are exactly zero in every block: the log was interrupted, (P,)."""
    if 1 not in sweep.harmonics:
        return np.zeros(sweep.n_points, dtype=bool)
    h, points = sweep.harmonic(1), np.arange(sweep.n_points)
    signals = [x for x in (sweep.U, sweep.I, sweep.Y) if x is not None]
    silent = [np.all(x[points, :, h, sweep.axis] == 0, axis=1) for x in signals]
    return np.asarray(np.all(silent, axis=0) & (sweep.amplitude_a > 0))


def _swapped_with(sweep: Sweep, fundamental: Complex, k: int) -> int | None:
    """The axis whose channel answers to the excitation of axis ``k``, as that of ``k`` does to its own; or None.

    ``fundamental`` has shape (P, B, n).
    """
    excited = sweep.amplitude_a > 0
    for other in range(fundamental.shape[2]):
        own, theirs = (excited & (sweep.axis == axis) for axis in (k, other))
        if other == k or theirs.sum() < FEWEST or not _dead(fundamental[theirs, :, other], ""):
            continue
        if not _dead(fundamental[own, :, other], "") and not _dead(fundamental[theirs, :, k], ""):
            return other
    return None


def _dead(blocks: Complex, unit: str) -> str:
    """What a dead channel reads, in words, from fundamentals (P, B); "" of a live one."""
    if not np.isfinite(blocks).all():
        return ""
    if np.abs(blocks - blocks.flat[0]).max() <= SAME:
        return f"reads {abs(blocks.flat[0]):.3g} {unit} in every block"
    n = blocks.shape[1]
    mean = blocks.mean(axis=1)
    scatter = np.sum(np.abs(blocks - mean[:, None]) ** 2, axis=1)
    if n > 1 and np.median(n * (n - 1) * np.abs(mean) ** 2 - NOISE * scatter) < 0:
        return f"is no more than noise ({np.sqrt(np.mean(np.abs(blocks) ** 2)):.2g} {unit})"
    return ""
