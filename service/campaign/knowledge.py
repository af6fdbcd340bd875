"""What a campaign knows of the rig so far: noise, closed-loop responses, and how long it takes to settle.

Every finished point adds to it; the plan reads from it. Nothing here assumes a model: responses between measured
frequencies are interpolated.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.campaign.noise import NoiseSpectra

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

SHORTER = 0.9
"""Settling of a new point against that of its neighbour: the time shrinks again away from a resonance."""


@dataclass(frozen=True)
class Response:
    """Closed-loop responses to one ampere of excitation: largest of all axes, and as vectors of magnitudes."""

    u: float
    """Of the excited axis, A/A."""
    i: float
    """Largest of all axes, A/A."""
    y: float
    """Largest of all axes, m/A."""
    y_vector: Real
    """(n_axes,) m/A."""
    i_excited: float
    """Of the excited axis, A/A."""
    i_times_y: float
    """Largest product of both in one axis, m/A."""


@dataclass
class _Axis:
    """Points measured with one axis excited, by frequency."""

    frequency_hz: list[float] = field(default_factory=list)
    magnitudes: list[Real] = field(default_factory=list)
    """(3, n_axes): |u|, |i|, |y| per ampere."""
    settle_s: list[float] = field(default_factory=list)
    caution: float = 1.0


class Knowledge:
    """Noise and responses of a rig.

    Parameters
    ----------
    noise
        Spectra of the preliminary step.
    n_axes
        Number of axes.
    """

    def __init__(self, noise: NoiseSpectra, n_axes: int) -> None:
        self.noise = noise
        self._axes = [_Axis() for _ in range(n_axes)]
        self._distorted_a_per_s, self._clean_a_per_s = np.inf, 0.0
        """Rate of change at which a current was distorted; amplifiers of one rig are alike. Infinite if none was."""

    def knows(self, axis: int) -> bool:
        """Whether any response with that axis excited is known."""
        return bool(self._axes[axis].frequency_hz)

    def add(self, axis: int, frequency_hz: float, U: Complex, I: Complex, Y: Complex, settle_s: float) -> None:
        """Add a point: (n_axes,) amplitudes per ampere of excitation, and the settling time that it needed."""
        a = self._axes[axis]
        values = np.abs(np.array([U, I, Y]))
        k = bisect.bisect_left(a.frequency_hz, frequency_hz)
        if k < len(a.frequency_hz) and a.frequency_hz[k] == frequency_hz:
            a.magnitudes[k], a.settle_s[k] = values, settle_s
            return
        a.frequency_hz.insert(k, frequency_hz)
        a.magnitudes.insert(k, values)
        a.settle_s.insert(k, settle_s)

    def response(self, axis: int, frequency_hz: float) -> Response:
        """Magnitudes at a frequency: log-log between neighbours.

        Beyond the last point, falling frequency may raise the displacement as its inverse square, as inertia does:
        the estimate errs to the safe side.
        """
        a = self._axes[axis]
        f = a.frequency_hz
        k = bisect.bisect_left(f, frequency_hz)
        if k == 0 or k == len(f):
            m = a.magnitudes[0 if k == 0 else -1].copy()
            if k == 0:
                m[2] *= (f[0] / frequency_hz) ** 2
        else:
            w = np.log(frequency_hz / f[k - 1]) / np.log(f[k] / f[k - 1])
            low, high = np.log(np.maximum(a.magnitudes[k - 1], 1e-300)), np.log(np.maximum(a.magnitudes[k], 1e-300))
            m = np.exp((1 - w) * low + w * high)
        return Response(
            u=float(m[0, axis]),
            i=float(m[1].max()),
            y=float(m[2].max()),
            y_vector=m[2],
            i_excited=float(m[1, axis]),
            i_times_y=float(np.max(m[1] * m[2])),
        )

    def noise_at_unit(self, axis: int, frequency_hz: float, amplifier: bool = False) -> float:
        """Relative standard deviation of a column of the response for 1 A over 1 s, n of eq. 3.18, A sqrt(s).

        ``amplifier`` leaves the displacement out.
        """
        r = self.response(axis, frequency_hz)
        variance = self.noise.block_variance(frequency_hz, 1.0)
        drive = variance["i"][axis] / r.i_excited**2 + variance["u"][axis] / r.u**2
        if amplifier:
            return float(np.sqrt(drive))
        plane = slice(axis // 2 * 2, axis // 2 * 2 + 2)
        with np.errstate(divide="ignore"):  # an answer below the log's resolution: no time is long enough
            output = np.sum(variance["y"][plane]) / np.sum(r.y_vector[plane] ** 2)
        return float(np.sqrt(output + drive))

    def caution(self, axis: int) -> float:
        """Share of the displacement and current limits to use: 1, less after trips."""
        return self._axes[axis].caution

    def tripped(self, axis: int) -> None:
        """A tone of that axis tripped: the next ones take a third less, down to a tenth."""
        self._axes[axis].caution = max(0.1, 0.7 * self._axes[axis].caution)

    def held(self, axis: int) -> None:
        """A tone of that axis did not trip: the next ones take a little more again."""
        self._axes[axis].caution = min(1.0, 1.1 * self._axes[axis].caution)

    @property
    def slew_a_per_s(self) -> float:
        """How fast a current may change, A/s: what a supply's voltage limit distorts, but never less than was clean.

        A stop or a magnet distorts a current, too, through the controller; it does so at low frequency as well, where
        the current changes slowly, and is then no reason to keep fast currents small.
        """
        return max(self._distorted_a_per_s, self._clean_a_per_s)

    def saturated(self, slew_a_per_s: float) -> None:
        """A current was distorted when it had to change that fast."""
        self._distorted_a_per_s = min(self._distorted_a_per_s, slew_a_per_s)

    def followed(self, slew_a_per_s: float) -> None:
        """A current changed that fast without distortion."""
        self._clean_a_per_s = max(self._clean_a_per_s, slew_a_per_s)

    def settle_s(self, axis: int, frequency_hz: float) -> float:
        """Settling time to start with: what the nearest points on either side needed, a little less; 0 without any."""
        a = self._axes[axis]
        k = bisect.bisect_left(a.frequency_hz, frequency_hz)
        near = a.settle_s[max(0, k - 1) : k + 1]
        return SHORTER * max(near, default=0.0)
