"""Phases of a multisine for small peaks where it counts: in the displacements of all axes in all experiments. Pure.

Clipping (Van der Ouderaa, Schoukens and Renneboog, IEEE Trans. Instrum. Meas. 37, 1988), for several outputs and
experiments of the same phases at once: every signal's time function is clipped at a share of its peak, the clipped
signals' spectra are projected on the phases that all of them share, and the amplitudes are put back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.multisine import Lines, Multisine, random_phases, synthesise

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

ROUNDS = 120
FIRST_CLIP, LAST_CLIP = 0.75, 0.96
"""Share of the peak at which the signals are clipped, from the first round to the last."""


def predicted_peaks(multisine: Multisine, responses: dict[str, Complex]) -> dict[str, Real]:
    """Largest absolute value of every signal over all experiments, (outputs,) by name.

    Parameters
    ----------
    responses
        Frequency responses from r at the excited lines, (L, outputs, n), of each signal.
    """
    return {
        name: np.max([np.max(np.abs(_signal(multisine, G, e)), axis=0) for e in range(multisine.n_inputs)], axis=0)
        for name, G in responses.items()
    }


def _signal(multisine: Multisine, response: Complex, e: int) -> Real:
    X = np.einsum("lkj,lj->lk", response, multisine.experiment(e))
    return synthesise(X, multisine.lines.excited, multisine.lines.samples)


def optimised(
    lines: Lines, amplitude_a: Real, response: Complex, rng: np.random.Generator, rounds: int = ROUNDS
) -> Multisine:
    """A random-phase multisine whose peaks of displacement were pressed down.

    Parameters
    ----------
    lines
        Where to excite.
    amplitude_a
        (L, n) amplitude of every input.
    response
        (L, outputs, n) from r to what must stay small, each output relative to its limit.
    rng
        Draws the phases with which the search begins: another realisation for another draw.
    rounds
        Of clipping.
    """
    n = amplitude_a.shape[1]
    # half the samples suffice to see the peaks of lines far below the Nyquist frequency
    samples = _coarse(lines)
    grid = Lines(samples, lines.excited, lines.odd, lines.even)
    phases = random_phases(len(lines.excited), n, rng)
    best, best_peak = phases, np.inf
    for k in range(rounds + 1):
        trial = Multisine(grid, amplitude_a * phases)
        signals = [_signal(trial, response, e) for e in range(n)]
        peak = max(float(np.max(np.abs(x))) for x in signals)
        if peak < best_peak:
            best, best_peak = phases, peak
        if k == rounds or peak == 0.0:
            break
        level = peak * (FIRST_CLIP + (LAST_CLIP - FIRST_CLIP) * k / rounds)
        wanted = np.zeros_like(phases)
        for e, x in enumerate(signals):
            half = np.fft.rfft(np.clip(x, -level, level), axis=0)[lines.excited] * (2 / samples)
            back = np.einsum("lkj,lk->lj", response.conj(), half)
            wanted += trial.mixing[e].conj() * amplitude_a * back
        size = np.abs(wanted)
        phases = np.where(size > 0, wanted / np.where(size > 0, size, 1.0), phases)
    return Multisine(lines, amplitude_a * best)


def _coarse(lines: Lines) -> int:
    """Samples of a period that show the peaks: at least five for the highest line's period."""
    top = int(lines.excited[-1])
    from scipy.fft import next_fast_len  # takes a while, and only who makes phases needs it

    return min(lines.samples, int(next_fast_len(5 * top, real=True)))
