"""The figure of a discrepancy that no effect explains."""

from __future__ import annotations

from typing import Any

import numpy as np

from service.report.figure import BAD, FOURTH, GOOD, MEASURED, MODEL, SECOND, Figure, log_magnitude, points


def discrepancy_figure(found: dict[str, Any], most: int = 6) -> Figure:
    """Size and phase of a discrepancy by frequency, sweep by sweep, of the channels where it is most significant."""
    series = sorted(found["fundamental"], key=lambda c: -float(c["significance"] or 0.0))
    channels = list(dict.fromkeys((c["output"], c["input"]) for c in series))[:most]
    colours = dict(zip(channels, (MODEL, SECOND, GOOD, BAD, FOURTH, MEASURED), strict=False))
    fig = Figure("discrepancy", 2, 1, 460)
    sizes, hz = [], []
    for c in series:
        channel = (c["output"], c["input"])
        if channel not in colours:
            continue
        error = 100 * (np.array(c["re"]) + 1j * np.array(c["im"]))
        at, fitted = np.array(c["frequency_hz"]), c["sweep"] == "fitted"
        name = f"{found['signal']} {channel[0]} from {channel[1]}, {c['sweep']} sweep"
        symbol = "circle" if fitted else "diamond-open"
        fig.add(0, 0, points(at, np.abs(error), name, colours[channel], size=5, symbol=symbol))
        fig.add(1, 0, points(at, np.degrees(np.angle(error)), name, colours[channel], size=5, symbol=symbol))
        sizes.append(np.abs(error))
        hz.append(at)
    fig.y(0, 0, title="error, %", **log_magnitude(sizes, floor=1e-4))
    fig.y(1, 0, title="phase, deg", range=[-185, 185], tickvals=[-180, -90, 0, 90, 180])
    every = np.concatenate(hz)
    for row in range(2):
        fig.frequency(row, 0, float(every.min()), float(every.max()), title=row == 1)
    return fig
