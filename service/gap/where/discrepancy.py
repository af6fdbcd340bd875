"""What no effect explains, as it was measured: the discrepancy of plant, amplifiers or controller, without a law.

Errors of the plain twin over the measured signal of the excited axis, by frequency, amplitude and channel: what is in
proportion to the excitation is the same at every amplitude, and its shape over frequency is that of what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from service.gap.fitting.predict import NOTHING_SEEN, NOTHING_TOLD, weight
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import SIGNIFICANT, worst
from service.gap.where.dependence import relative_error
from service.gap.which.explained import Explained
from service.gap.which.held_out import on_sweep

DIGITS = 5
"""Significant digits: finer than any noise."""


def discrepancy(found: Sequence[Explained], path: str, other: Observation) -> dict[str, Any] | None:
    """What the plain twin leaves of a part on both sweeps, channel by channel; None where there is no such part.

    ``fundamental`` holds all channels, ``harmonics`` those of the excited axis that are significant: their error over
    the same signal.
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
            drive = {
                "sweep": sweep,
                "input": axes[b],
                "frequency_hz": _told(o.points_hz[points]),
                "amplitude_a": _told(np.abs(o.R[points, o.fundamental, b])),
            }
            for a in range(len(axes)):
                sure = worst([z[points, o.fundamental, a]], looked_at=len(axes) ** 2)
                of = {"output": axes[a], "significance": sure} | _complex(error[points, a])
                fundamental.append(drive | of | {"std": _told(np.sqrt(variance[points, a]))})
            w = weight(o, signal)[points, :, b]
            size = np.abs(o.U if signal == "u" else o.I if signal == "i" and o.I is not None else o.Y)
            for k, h in enumerate(o.harmonics):
                sure = worst([z[points, k, b]], looked_at=len(axes) * len(o.harmonics))
                if h > 1 and sure > SIGNIFICANT:
                    seen = np.maximum(size[points, o.fundamental, b], NOTHING_SEEN)
                    over = z[points, k, b] / np.maximum(w[:, k], NOTHING_TOLD) / seen
                    told = {"output": axes[b], "harmonic": h, "significance": sure} | _complex(over)
                    harmonics.append(drive | told)
    return {"path": path, "signal": signal, "fundamental": fundamental, "harmonics": harmonics}


def _complex(values: Any) -> dict[str, list[float]]:
    return {"re": _told(values.real), "im": _told(values.imag)}


def _told(values: Any) -> list[float]:
    return [float(f"{v:.{DIGITS}g}") for v in values]
