"""Thinning of a sweep to the lines that carry most of its information."""

from __future__ import annotations

import numpy as np

from service.experiment.data import Sweep

LINES = 64
"""Lines that a diagnosis works on: more cost time and add little, as the twin's own error is the limit."""


def thinned(sweep: Sweep, lines: int = LINES) -> Sweep:
    """The sweep with at most ``lines`` frequencies, spread by how much log |Y / R| changes between them."""
    frequency, line = np.unique(sweep.frequency_hz, return_inverse=True)
    if len(frequency) <= lines:
        return sweep
    f = sweep.harmonics.index(1)
    points = np.arange(sweep.n_points)
    gain = np.abs(sweep.Y[points, :, f, sweep.axis].mean(axis=1)) / np.maximum(sweep.amplitude_a, 1e-12)
    level = np.bincount(line, np.log(np.maximum(gain, 1e-30))) / np.maximum(np.bincount(line), 1)
    variation = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(level)) + np.diff(np.log(frequency)))])
    wanted = np.linspace(0, variation[-1], lines)
    chosen = np.unique(np.clip(np.searchsorted(variation, wanted), 0, len(frequency) - 1))
    return sweep.select(np.isin(line, chosen))
