"""The discrepancy of a part that no effect explains, as measured: the plain twin's relative errors, without a law.

They are errors over the measured signal of the excited axis, by frequency, amplitude and channel. Of a linear
discrepancy they are the same at every amplitude, and their shape over frequency is that of the missing law.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from service.gap.fitting.predict import TINY_SIGNAL, TINY_WEIGHT, weight
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import SIGNIFICANT, worst
from service.gap.which.between_sweeps import relative_error
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep

DIGITS = 5
"""Significant digits of the report: finer than any noise."""


def discrepancy(found: Sequence[Explained], path: str, other: Observation) -> dict[str, Any] | None:
    """Relative errors of the plain twin in a part on both sweeps, for gap.json; None where there is no such part.

    "fundamental" holds all channels, "harmonics" the significant ones of the excited axis, over its fundamental.
    """
    e = next((e for e in found if e.part.path == path), None)
    if e is None:
        return None
    signal, axes = e.part.signal, e.ground.nuisance.rig.axes
    sweeps = [(e.ground.observations[0], e.plain[0]), on_sweep(e, e.null.candidate, other)]
    fundamental: list[dict[str, Any]] = []
    harmonics: list[dict[str, Any]] = []
    for sweep, (o, z) in zip(("fitted", "other"), sweeps, strict=True):
        error, variance = relative_error(z, o, signal)
        for b in sorted(set(o.axis.tolist())):
            points = np.flatnonzero(o.axis == b)
            points = points[np.argsort(o.points_hz[points], kind="stable")]
            excitation = {
                "sweep": sweep,
                "input": axes[b],
                "frequency_hz": _rounded(o.points_hz[points]),
                "amplitude_a": _rounded(np.abs(o.R[points, o.fundamental, b])),
            }
            for a in range(len(axes)):
                significance = worst([z[points, o.fundamental, a]], looked_at=len(axes) ** 2)
                channel = {"output": axes[a], "significance": significance} | _complex(error[points, a])
                fundamental.append(excitation | channel | {"std": _rounded(np.sqrt(variance[points, a]))})
            w = weight(o, signal)[points, :, b]
            size = np.abs(o.U if signal == "u" else o.I if signal == "i" and o.I is not None else o.Y)
            for k, h in enumerate(o.harmonics):
                significance = worst([z[points, k, b]], looked_at=len(axes) * len(o.harmonics))
                if h > 1 and significance > SIGNIFICANT:
                    excited = np.maximum(size[points, o.fundamental, b], TINY_SIGNAL)
                    relative = z[points, k, b] / np.maximum(w[:, k], TINY_WEIGHT) / excited
                    channel = {"output": axes[b], "harmonic": h, "significance": significance} | _complex(relative)
                    harmonics.append(excitation | channel)
    return {"path": path, "signal": signal, "fundamental": fundamental, "harmonics": harmonics}


def _complex(values: Any) -> dict[str, list[float]]:
    return {"re": _rounded(values.real), "im": _rounded(values.imag)}


def _rounded(values: Any) -> list[float]:
    return [float(f"{v:.{DIGITS}g}") for v in values]
