"""What the rig does without being asked: noise spectra of u, i and y, and lines such as the mains.

Two records tell them, as section 3 of the thesis proposes: one without excitation, and periodic ones whose averaged
period is subtracted, so that noise that only excitation brings is seen too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]

SIGNALS = ("u", "i", "y")
SEGMENT_S = 0.25
"""Length of a Welch segment: 4 Hz of resolution, half the distance from the mains to its neighbours and less."""
LINE_RATIO = 12.0
"""A spectral line stands that far above its surroundings; chance alone does so in less than 1e-4 of the lines."""


@dataclass(frozen=True)
class NoiseSpectra:
    """One-sided power spectral densities of the noise, per axis."""

    frequency_hz: Real
    """(F,), rising, without zero."""
    density: dict[str, Real]
    """"u", "i" in A^2/Hz and "y" in m^2/Hz, (F, n_axes) each."""
    lines_hz: tuple[float, ...] = ()
    """Spectral lines found in the zero-excitation record."""
    raw: dict[str, Real] | None = None
    """The same densities before smoothing, lines and all, when ``frequency_hz`` is evenly spaced."""

    @classmethod
    def unmeasured(cls) -> NoiseSpectra:
        """Of a rig that was not listened to yet: no signal has a density."""
        return cls(np.array([1.0, 2.0]), {})

    @cached_property
    def _logarithms(self) -> tuple[Real, Real]:
        """Of the frequencies, (F,), and of the densities, (F, signals, n_axes): a plan asks some ten times a tone."""
        return np.log(self.frequency_hz), np.log(np.stack(list(self.density.values()), axis=1))

    def at(self, frequency_hz: float) -> dict[str, Real]:
        """Densities at a frequency, (n_axes,) each, log-log interpolated and held beyond the ends."""
        x, d = self._logarithms
        here = math.log(frequency_hz)
        k = min(max(int(np.searchsorted(x, here)), 1), len(x) - 1)
        w = min(max((here - x[k - 1]) / (x[k] - x[k - 1]), 0.0), 1.0)
        return dict(zip(self.density, np.exp((1 - w) * d[k - 1] + w * d[k]), strict=True))

    def block_variance(self, frequency_hz: float, seconds: float) -> dict[str, Real]:
        """Variance E|X|^2 of a complex amplitude measured over ``seconds``, (n_axes,) each.

        2 S / T in a smooth spectrum. A line beside the frequency leaks into a short block: as long as the spectrum
        resolves the block's width 1/T, S is averaged over the block's own window, sinc^2.
        """
        return self._leaked(frequency_hz, seconds) or {s: 2 * d / seconds for s, d in self.at(frequency_hz).items()}

    def _leaked(self, frequency_hz: float, seconds: float) -> dict[str, Real] | None:
        """`block_variance` over the block's own window; None where the spectrum does not resolve that."""
        step = float(self.frequency_hz[1] - self.frequency_hz[0])
        if self.raw is None or seconds * step > 1:
            return None
        window = np.sinc((self.frequency_hz - frequency_hz) * seconds) ** 2
        return {s: 2 * step * (window @ d) for s, d in self.raw.items()}

    def mean_variance(self, frequency_hz: float, seconds: float, blocks: int) -> dict[str, Real]:
        """Variance of the mean of blocks, (n_axes,) each: noise averages out, a line beside the frequency may not."""
        smooth = {s: 2 * d / seconds for s, d in self.at(frequency_hz).items()}
        whole = self._leaked(frequency_hz, seconds) or smooth
        return {s: np.maximum(whole[s] - smooth[s], 0.0) + smooth[s] / blocks for s in whole}

    def joined(self, other: NoiseSpectra) -> NoiseSpectra:
        """The larger of both at every frequency."""
        density = {s: d.copy() for s, d in self.density.items()}
        raw = None if self.raw is None else {s: d.copy() for s, d in self.raw.items()}
        for k, f in enumerate(self.frequency_hz):
            more = other.at(float(f))
            for s in density:
                density[s][k] = np.maximum(density[s][k], more[s])
                if raw is not None:
                    raw[s][k] = np.maximum(raw[s][k], more[s])
        return NoiseSpectra(self.frequency_hz, density, self.lines_hz, raw)


def welch(signal: Real, sample_rate_hz: float) -> tuple[Real, Real]:
    """One-sided density (F, n) of (N, n) records by Welch's method, Hann window, half overlap, mean removed."""
    size = min(len(signal), max(8, round(SEGMENT_S * sample_rate_hz)))
    window = np.hanning(size + 1)[:-1]
    centred = signal - signal.mean(axis=0)
    starts = range(0, len(signal) - size + 1, max(1, size // 2))
    total = np.zeros((size // 2 + 1, signal.shape[1]))
    for start in starts:
        total += np.abs(np.fft.rfft(centred[start : start + size] * window[:, None], axis=0)) ** 2
    scale = 2 / (sample_rate_hz * np.sum(window**2) * len(starts))
    frequency: Real = np.fft.rfftfreq(size, 1 / sample_rate_hz).astype(np.float64)
    return frequency, total * scale


def smoothed(density: Real, octave: float = 1 / 3) -> Real:
    """Running geometric mean over a constant share of an octave, (F, n), and at least over three lines."""
    logs = np.log(np.maximum(density, np.finfo(float).tiny))
    cumulative = np.concatenate([np.zeros((1, density.shape[1])), np.cumsum(logs, axis=0)])
    k = np.arange(len(density))
    low = np.clip(np.minimum(np.floor(k * 2 ** (-octave / 2)), k - 1), 0, None).astype(int)
    high = np.clip(np.maximum(np.ceil(k * 2 ** (octave / 2)), k + 1), None, len(density) - 1).astype(int) + 1
    mean: Real = np.exp((cumulative[high] - cumulative[low]) / (high - low)[:, None])
    return mean


def spectra(records: dict[str, Real], sample_rate_hz: float) -> NoiseSpectra:
    """Noise spectra of a record without excitation; lines stay in, a little broadened.

    Parameters
    ----------
    records
        "u", "i", "y", (N, n_axes) each.
    """
    lines: set[float] = set()
    density: dict[str, Real] = {}
    raw: dict[str, Real] = {}
    frequency = np.zeros(0)
    for s in SIGNALS:
        frequency, p = welch(records[s], sample_rate_hz)
        frequency, p = frequency[1:], np.maximum(p[1:], np.finfo(float).tiny)
        high = np.any((p > LINE_RATIO * smoothed(p))[1:-1] & (p[1:-1] >= p[:-2]) & (p[1:-1] >= p[2:]), axis=1)
        lines |= set(frequency[1:-1][high].tolist())
        # finer than for the lines: a resonance of the loop makes a narrow rise of the noise
        density[s], raw[s] = smoothed(p, 1 / 24), p
    return NoiseSpectra(frequency, density, tuple(sorted(lines)), raw)


def without_mean_block(records: dict[str, Real], block_samples: int) -> dict[str, Real]:
    """Noise of a periodic record: the averaged block subtracted from every block, scaled for the lost freedom."""
    out = {}
    for s in SIGNALS:
        n = records[s].shape[1]
        blocks = records[s].reshape(-1, block_samples, n)
        scale = np.sqrt(len(blocks) / (len(blocks) - 1))
        out[s] = ((blocks - blocks.mean(axis=0)) * scale).reshape(-1, n)
    return out


def from_blocks(frequency_hz: Real, amplitudes: dict[str, NDArray[np.complex128]], block_s: Real) -> NoiseSpectra:
    """Spectra from unexcited tones, for a controller that gives no records.

    Parameters
    ----------
    frequency_hz
        (F,) rising.
    amplitudes
        "u", "i", "y": complex amplitudes at each frequency, (F, B, n_axes).
    block_s
        (F,) length of a block.
    """
    density = {
        s: np.maximum(np.mean(np.abs(a) ** 2, axis=1) * block_s[:, None] / 2, np.finfo(float).tiny)
        for s, a in amplitudes.items()
    }
    return NoiseSpectra(frequency_hz, density)
