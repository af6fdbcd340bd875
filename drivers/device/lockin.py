"""What a controller does with a tone: make the cosine at its own sample rate, and demodulate by lock-in."""

from __future__ import annotations

import numpy as np

from drivers.controller import HARMONICS, Tone
from sim.rig import Array

AMPLITUDE_STEPS_PER_A = 1_000_000
"""Resolution of the excitation's amplitude; every driver therefore excites with the same amplitude."""


def quantised_amplitude(amplitude_a: float) -> float:
    """Amplitude that the controller really plays, A: the nearest whole microampere.

    >>> quantised_amplitude(0.1234567)
    0.123457
    """
    return round(amplitude_a * AMPLITUDE_STEPS_PER_A) / AMPLITUDE_STEPS_PER_A


def quantised_waveform(r_a: Array) -> Array:
    """Waveform that the controller really plays, A: whole microamperes, as for the amplitude of a tone."""
    return np.asarray(np.round(np.asarray(r_a, dtype=float) * AMPLITUDE_STEPS_PER_A) / AMPLITUDE_STEPS_PER_A)


def cosine(tone: Tone, first: int, count: int) -> Array:
    """Unit cosine at samples ``first`` to ``first + count``, (count,); sample 0 starts the first block.

    The phase is reduced in whole numbers, so it stays exact however long the tone lasts.
    """
    k = np.arange(first, first + count, dtype=np.int64)
    return np.asarray(np.cos(2 * np.pi * ((tone.periods * k) % tone.samples) / tone.samples), dtype=float)


def smooth_step(position: Array) -> Array:
    """Raised cosine from 0 at position 0 to 1 at position 1, without a jump in value or slope."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(position, 0.0, 1.0))


def ramp_samples(tone: Tone, sample_rate_hz: float) -> int:
    """Length of the ramps: two periods, at least 20 ms and at most 250 ms; none without excitation."""
    if quantised_amplitude(tone.amplitude_a) == 0:
        return 0
    seconds = min(max(2 / tone.frequency_hz(sample_rate_hz), 0.02), 0.25)
    return int(np.ceil(seconds * sample_rate_hz))


class LockIn:
    """Complex amplitudes per block, gathered chunk by chunk: no record of the tone is kept.

    X_h = 2/N sum x(k) exp(-j 2 pi h periods k / N), the mean for h = 0. A harmonic at or above half the
    sample rate cannot be told from a lower one and gives 0.

    >>> tone = Tone(axis=0, amplitude_a=1.0, periods=3, samples=100, blocks=2)
    >>> lockin = LockIn(tone, signals=1)
    >>> lockin.add(5.0 + 2.0 * cosine(tone, 0, 200)[:, None])
    >>> abs(lockin.amplitudes[:, :2, 0].round(12)).tolist()
    [[5.0, 2.0], [5.0, 2.0]]
    """

    def __init__(self, tone: Tone, signals: int, harmonics: tuple[int, ...] = HARMONICS) -> None:
        n = tone.samples
        h = np.asarray(harmonics, dtype=np.int64)
        self.amplitudes = np.zeros((tone.blocks, len(h), signals), dtype=np.complex128)
        """(blocks, harmonics, signals); complete after blocks * samples samples."""
        self._step = h * tone.periods
        self._weight = np.where(2 * self._step >= n, 0.0, np.where(h == 0, 1.0, 2.0) / n)
        self._samples = n
        self._next = 0

    def add(self, signals: Array) -> None:
        """Take the next samples, (M, signals); M need not end with a block."""
        done = 0
        while done < len(signals):
            block, first = divmod(self._next, self._samples)
            m = min(self._samples - first, len(signals) - done)
            k = np.arange(first, first + m, dtype=np.int64)
            phase = (self._step[:, None] * k) % self._samples
            kernel = self._weight[:, None] * np.exp(-2j * np.pi * phase / self._samples)
            self.amplitudes[block] += kernel @ signals[done : done + m]
            self._next += m
            done += m
