"""Whether the amplitudes that a file states are those of the excitation that it recorded."""

from __future__ import annotations

import numpy as np

from service.experiment.data import Experiment, Sweep

FACTOR = 1.5
"""Stated over recorded, or the other way round, from which it is no rounding and no ramp: peak to peak, mA, a wrong
frequency."""
NAMED = 3
"""Points that a sentence names."""


def stated_amplitudes(experiment: Experiment) -> list[str]:
    """Sweeps whose ``amplitude_a`` is not what R is, one sentence each.

    Every figure is worked out from the recorded R, so that such a file is read all the same; but one of the two is
    wrong, and if it is R, so are the figures.
    """
    found = ((f"sweeps/{k}", s) for k, s in enumerate(experiment.sweeps) if s.kind != "noise")
    return [sentence for name, sweep in found if (sentence := _doubt(name, sweep))]


def _doubt(name: str, sweep: Sweep) -> str:
    own = np.take_along_axis(sweep.R[:, :, sweep.harmonic(1)], sweep.axis[:, None, None], axis=2)[:, :, 0]
    recorded_a, stated_a = np.abs(own).mean(axis=1), sweep.amplitude_a
    known = (stated_a > 0) & (recorded_a > 0)  # a point that was not excited states 0, or records 0
    ratio = np.where(known, stated_a, 1.0) / np.where(known, recorded_a, 1.0)
    wrong = np.flatnonzero(np.abs(np.log(ratio)) > np.log(FACTOR))
    if not len(wrong):
        return ""
    first = wrong[0]
    points = ", ".join(map(str, wrong[:NAMED])) + (", ..." if len(wrong) > NAMED else "")
    return (
        f"{name}: amplitude_a is not the amplitude of the recorded r at {len(wrong)} of {len(ratio)} points ({points}; "
        f"at {first} {stated_a[first]:.3g} A is stated and {recorded_a[first]:.3g} A recorded): the recorded one "
        "counts; state the peak of r in A, and check frequency_hz and the unit of r"
    )
