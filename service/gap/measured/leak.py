"""What the slow rest of a start leaks into the harmonics of a block.

A start leaves the loop's slowest state, mostly the integrator's, to die away over seconds: in the blocks of a low line
it is nearly a straight slope. One that changes by d over a block of k periods leaves d / (pi h k) at harmonic h, with
the phase at which the block begins. The rotor answers to it as to a constant, so a model at the harmonic's frequency
fails there by as much as it differs from the one at rest: up to ten standard deviations of the noise in a rig that
settles for a third of a second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.settling import FALSE_DRIFT_PROBABILITY, trend

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def leaked(sweep: Sweep, harmonic: int, model: Complex, effect: Complex, cause: Complex) -> Real:
    """Amplitude that slopes leave in the mean of what a model leaves of a signal, (P, n).

    Parameters
    ----------
    harmonic
        At which the model is taken; 1 or more.
    model : (P, n, n)
    effect, cause
        Means of the blocks of what the model predicts and of what it predicts it from, harmonic 0, (P, B, n).
    """
    sloping = effect - np.einsum("pij,pbj->pbi", model, cause)
    probability, change = trend(sloping)
    per_block = np.where(probability < FALSE_DRIFT_PROBABILITY, change, 0.0) / max(effect.shape[1] - 1, 1)
    return np.asarray(per_block / (np.pi * harmonic * periods(sweep)[:, None]))


def periods(sweep: Sweep) -> Real:
    """Periods in a block of each point, (P,): as few as can be, one, where the file does not tell."""
    if sweep.block_samples is None:
        return np.ones(sweep.n_points)
    return np.maximum(1.0, np.round(sweep.frequency_hz * sweep.block_samples / sweep.sample_rate_hz))
