"""Noise, even and odd distortion of a multisine experiment, told apart by its detection lines. Pure.

Noise is what differs from period to period; what repeats with the period at lines that nobody excited was made by a
nonlinearity: at even lines an even one, at odd lines an odd one (Pintelon and Schoukens, System Identification, 4.3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.experiment.multisine import Lines

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


@dataclass(frozen=True)
class Distortion:
    """Root mean square amplitudes of one signal, (n_axes,) each, in its unit: of a line's mean over the periods."""

    signal: Real
    """At the excited lines."""
    noise: Real
    """Standard deviation of the mean over the periods, excited and detection lines together."""
    odd: Real
    """At odd detection lines, noise taken off; zero where noise explains it."""
    even: Real
    """The same at even lines."""

    def in_decibels(self) -> dict[str, Real]:
        """Noise, odd and even distortion over the signal, dB; -inf where there is none, not even a signal."""
        found = {}
        for k in ("noise", "odd", "even"):
            with np.errstate(divide="ignore"):
                level = np.divide(getattr(self, k), self.signal, out=np.zeros_like(self.signal), where=self.signal > 0)
                found[k] = 20 * np.log10(level)
        return found


def levels(periods: Complex, lines: Lines) -> Distortion:
    """Levels of one experiment.

    Parameters
    ----------
    periods
        (P, L + odd + even, n) amplitudes of one signal, period by period, at the excited lines, then at
        ``lines.detection``; P at least 2.
    lines
        Which is which.

    Raises
    ------
    ValueError
        One period only: noise cannot be told from distortion.
    """
    if len(periods) < 2:
        raise ValueError("one period cannot tell noise from distortion; record at least two")
    mean = periods.mean(axis=0)
    variance = np.sum(np.abs(periods - mean) ** 2, axis=0) / (len(periods) - 1) / len(periods)
    n, m = len(lines.excited), len(lines.odd)
    noise = variance.mean(axis=0)

    def beyond(where: slice) -> Real:
        if not len(mean[where]):
            return np.zeros(mean.shape[1])
        # the lines' own noise, colour included; what three standard deviations of its mean explain is no distortion
        own = variance[where].mean(axis=0)
        excess = np.mean(np.abs(mean[where]) ** 2, axis=0) - own
        chance = 3 * own * np.sqrt((1 + 1 / (len(periods) - 1)) / len(mean[where]))
        return np.asarray(np.sqrt(np.where(excess > chance, excess, 0.0)))

    return Distortion(
        np.sqrt(np.mean(np.abs(mean[:n]) ** 2, axis=0)),
        np.sqrt(noise),
        beyond(slice(n, n + m)),
        beyond(slice(n + m, None)),
    )


def pooled(found: list[Distortion]) -> Distortion:
    """Levels of several experiments together: means of the powers."""
    return Distortion(
        *(np.sqrt(np.mean([getattr(d, k) ** 2 for d in found], axis=0)) for k in ("signal", "noise", "odd", "even"))
    )
