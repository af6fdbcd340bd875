"""Odd random-phase multisines on all inputs at once: lines, orthogonal experiments, waveforms, demodulation. Pure.

A period of N samples holds lines k at k * rate / N. Only odd lines are excited, and out of every group of neighbouring
ones a random one is left out: what appears there is odd distortion, what appears at even lines is even distortion,
both on top of the noise that the periods tell (Pintelon and Schoukens, System Identification, 2nd ed., 4.3 and 7.3).
With n inputs, n experiments of one realisation play r_j = W[e, j] x_j with W W^H = n I, x_j the multisine of input j:
W^H of the experiments' spectra gives n columns, each as if its input had been excited alone, with the noise variance
of n averages (orthogonal multisines, Dobrowiecki and Schoukens, Automatica 43, 2007). That is what an experiment file
holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]
Integers = NDArray[np.int64]

GROUP = 4
"""Neighbouring odd lines of which one is left out at random to detect odd distortion."""


@dataclass(frozen=True)
class Lines:
    """Lines of a period of ``samples`` samples: which are excited, and which only watch."""

    samples: int
    excited: Integers
    """(L,) odd, rising."""
    odd: Integers
    """Odd lines that are not excited."""
    even: Integers
    """Even lines in the same band."""

    @property
    def detection(self) -> Integers:
        """Odd ones, then even ones."""
        return np.concatenate([self.odd, self.even])

    def frequency_hz(self, sample_rate_hz: float) -> Real:
        """(L,) frequencies of the excited lines, Hz."""
        return np.asarray(self.excited * (sample_rate_hz / self.samples))


def choose_lines(
    samples: int,
    sample_rate_hz: float,
    from_hz: float,
    to_hz: float,
    count: int,
    rng: np.random.Generator,
    avoid_hz: tuple[float, ...] = (),
    wanted_hz: Sequence[tuple[float, float]] = (),
) -> Lines:
    """About ``count`` odd lines, spread evenly in the logarithm of frequency as far as the grid allows.

    Parameters
    ----------
    samples, sample_rate_hz
        Length of a period, and its rate.
    from_hz, to_hz
        Band.
    count
        Wanted number of lines, detection lines included; fewer where the grid is coarser.
    rng
        Draws the odd lines that are left out.
    avoid_hz
        Frequencies, such as the mains, whose nearest line is not used.
    wanted_hz
        Bands (from, to) of which every odd line is excited, and those to either side: none is left out there.

    Raises
    ------
    ValueError
        The band holds fewer than eight odd lines.
    """
    step = sample_rate_hz / samples
    first, last = int(np.ceil(from_hz / step - 1e-9)), int(np.floor(to_hz / step + 1e-9))
    odd = np.arange(first + (first + 1) % 2, last + 1, 2)
    hum = np.unique(np.round(np.array(avoid_hz, dtype=float) / step).astype(np.int64))
    odd = odd[~np.isin(odd, hum)]
    if len(odd) < 8:
        raise ValueError(f"{from_hz:g} to {to_hz:g} Hz hold {len(odd)} odd lines of {step:g} Hz; lengthen the period")
    # as many per octave as fit: where the grid is too coarse every odd line is taken, and the rest go higher up
    wanted, chosen = count, odd
    for _ in range(30):
        targets = np.geomspace(odd[0], odd[-1], wanted)
        chosen = np.unique(odd[np.clip(np.searchsorted(odd, targets), 0, len(odd) - 1)])
        if len(chosen) >= min(count, len(odd)):
            break
        wanted = int(1.15 * wanted) + 1
    wanted_here = np.zeros(len(odd), dtype=bool)
    for low, high in wanted_hz:
        wanted_here |= (odd * step > low - 2 * step) & (odd * step < high + 2 * step)
    others = np.setdiff1d(chosen, odd[wanted_here])
    chosen = np.union1d(chosen, odd[wanted_here])
    left_out = np.zeros(len(chosen), dtype=bool)
    for start in range(0, len(others) - GROUP + 1, GROUP):
        left_out[np.searchsorted(chosen, others[start + int(rng.integers(GROUP))])] = True
    even = np.arange(first + first % 2, last + 1, 2)
    return Lines(samples, chosen[~left_out], chosen[left_out], even[(even > 0) & ~np.isin(even, hum)])


def orthogonal(n: int) -> Complex:
    """Unitary matrix times sqrt(n), entries of modulus one, (n, n): Hadamard where n is a power of two, else DFT.

    >>> orthogonal(2).real.tolist()
    [[1.0, 1.0], [1.0, -1.0]]
    """
    if n & (n - 1) == 0:
        w = np.ones((1, 1))
        while len(w) < n:
            w = np.block([[w, w], [w, -w]])
        return w.astype(np.complex128)
    k = np.arange(n)
    return np.asarray(np.exp(2j * np.pi * np.multiply.outer(k, k) / n))


def random_phases(n_lines: int, n_inputs: int, rng: np.random.Generator) -> Complex:
    """Unit phasors, (L, n), uniform on the circle and independent: E[exp(j phi)] = 0."""
    return np.asarray(np.exp(2j * np.pi * rng.random((n_lines, n_inputs))))


@dataclass(frozen=True)
class Multisine:
    """One realisation: amplitudes and phases of every input's lines, and the n experiments that are made of them."""

    lines: Lines
    spectrum: Complex
    """(L, n) complex amplitudes of r of input j alone, A."""

    @property
    def n_inputs(self) -> int:
        """n, and the number of experiments."""
        return int(self.spectrum.shape[1])

    @cached_property
    def mixing(self) -> Complex:
        """(experiments, inputs)."""
        return orthogonal(self.n_inputs)

    def experiment(self, e: int) -> Complex:
        """(L, n) complex amplitudes of r in experiment e."""
        return np.asarray(self.spectrum * self.mixing[e])

    def waveform(self, e: int) -> Real:
        """(N, n) one period of r in experiment e, A."""
        return synthesise(self.experiment(e), self.lines.excited, self.lines.samples)

    def scaled(self, gain: float) -> Multisine:
        """The same at another level."""
        return Multisine(self.lines, self.spectrum * gain)


def synthesise(amplitudes: Complex, lines: Integers, samples: int) -> Real:
    """(samples, n) time signal of complex amplitudes (L, n) at lines, x(t) = Re(X exp(j w t))."""
    half = np.zeros((samples // 2 + 1, amplitudes.shape[1]), dtype=np.complex128)
    half[lines] = amplitudes * (samples / 2)
    return np.asarray(np.fft.irfft(half, samples, axis=0))


def spectra(record: Real, samples: int, lines: Integers) -> Complex:
    """Complex amplitudes at lines of every whole period of a record (P * samples, n): (P, L, n)."""
    periods = record.reshape(-1, samples, record.shape[1])
    return np.asarray(np.fft.rfft(periods, axis=1)[:, lines] * (2 / samples))


def separated(experiments: Complex, multisine: Multisine) -> Complex:
    """Columns as if each input had been excited alone, phases referred to that input.

    Parameters
    ----------
    experiments
        (E, L, n) complex amplitudes of one signal at the excited lines, one experiment after the other.

    Returns
    -------
    columns
        (L, n inputs, n): the signal per input, at a time origin where r of the input is real and positive.
    """
    n = multisine.n_inputs
    mixed = np.einsum("ej,elk->ljk", multisine.mixing.conj(), experiments) / n
    phase = multisine.spectrum / np.maximum(np.abs(multisine.spectrum), 1e-300)
    return np.asarray(mixed * phase.conj()[:, :, None])
