"""Frequency responses as an experiment on the rig in time would find them: the check of the linear model.

>>> import numpy as np
>>> from sim.reference import reference_rig
>>> from sim.twin import linear_model
>>> rig, frequency_hz = reference_rig(), np.array([130.0])
>>> found, theory = measured_responses(rig, frequency_hz, settle_s=1.0), linear_model(rig, frequency_hz)
>>> bool(np.linalg.norm(found.y_per_u - theory.y_per_u) < 1e-3 * np.linalg.norm(theory.y_per_u))
True
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.rig import Array, Noise, Rig
from sim.stepping import Simulation

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class MeasuredResponses:
    """Responses at F frequencies, matrices (F, output, input)."""

    i_per_u: Complex
    y_per_u: Complex
    u_per_r: Complex


def measured_responses(
    rig: Rig, frequency_hz: Array, amplitude_a: float = 1e-4, settle_s: float = 4.0, window_s: float = 1.0
) -> MeasuredResponses:
    """Responses of the rig in time to all tones at once, each input alone, without noise.

    Parameters
    ----------
    rig : Rig
    frequency_hz : (F,), each a whole number of periods in the window
    amplitude_a : of each tone, A; small for the small-signal response
    settle_s : time before the window, most of it used to let the tones grow
    window_s : time over which the signals are correlated with the tones

    Raises
    ------
    LevitationError
        The rig's controller does not hold the rotor.
    """
    period, n = rig.controller.sample_time_s, rig.n_axes
    quiet = replace(rig, noise=Noise())
    n_window = round(window_s / period)
    t = np.arange(round(settle_s / period) + n_window) * period
    # Schroeder's phases keep the crest of the sum low (IEEE Trans. Information Theory 16, 1970).
    phase = -np.pi * np.arange(len(frequency_hz)) ** 2 / len(frequency_hz)
    tones = amplitude_a * np.cos(2 * np.pi * np.outer(t, frequency_hz) + phase).sum(axis=1)
    # A slow, smooth start leaves barely damped modes alone, which could otherwise ring for minutes.
    tones *= np.sin(np.pi / 2 * np.minimum(t / (0.75 * settle_s), 1.0)) ** 2
    correlate = 2 / n_window * np.exp(-2j * np.pi * np.outer(frequency_hz, t[-n_window:]))
    R, U, I, Y = (np.empty((len(frequency_hz), n, n), dtype=complex) for _ in range(4))
    for axis in range(n):
        r = np.zeros((len(t), n))
        r[:, axis] = tones
        record = Simulation(quiet).advance(r, check_limits=False)
        for spectrum, signal in ((R, record.r), (U, record.u), (I, record.i), (Y, record.y)):
            spectrum[:, :, axis] = correlate @ signal[-n_window:]
    per_u: Complex = np.asarray(np.linalg.inv(U))
    per_r: Complex = np.asarray(np.linalg.inv(R))
    return MeasuredResponses(np.asarray(I @ per_u), np.asarray(Y @ per_u), np.asarray(U @ per_r))
