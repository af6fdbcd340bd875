"""Leakage of a slow transient into the harmonics of a block.

After a tone starts, the loop's slowest state, mostly the integrator's, decays over seconds: within a block it is nearly
a straight slope. A slope that changes by d over a block of k periods leaks d / (pi h k) into harmonic h. The plant
answers to the slope as at rest, not as at the harmonic's frequency, so a model at that frequency leaves a residual: up
to ten standard deviations of the noise in a rig that settles for a third of a second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.settling import FALSE_DRIFT_PROBABILITY, trend

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


def leaked(sweep: Sweep, harmonic: int, model: Complex, effect: Complex, cause: Complex) -> Real:
    """Amplitude that slopes leak into the mean residual of a model, output - model input, (P, n).

    Parameters
    ----------
    harmonic
        At which the model is taken; 1 or more.
    model
        Its response at that harmonic, (P, n, n).
    effect, cause
        Output and input of the model at harmonic 0, (P, B, n).
    """
    slowly_changing = effect - np.einsum("pij,pbj->pbi", model, cause)
    probability, change = trend(slowly_changing)
    per_block = np.where(probability < FALSE_DRIFT_PROBABILITY, change, 0.0) / max(effect.shape[1] - 1, 1)
    return np.asarray(per_block / (np.pi * harmonic * periods(sweep)[:, None]))


def periods(sweep: Sweep) -> Real:
    """Periods in a block of each point, (P,); 1, the fewest possible, where the file has no length of the blocks."""
    if sweep.block_samples is None:
        return np.ones(sweep.n_points)
    return np.maximum(1.0, np.round(sweep.frequency_hz * sweep.block_samples / sweep.sample_rate_hz))
