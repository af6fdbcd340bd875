"""Figures of a gap diagnosis: measured and twin before and after, where the residual is, which candidates there are."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.gap.diagnosis import Diagnosis
from service.gap.document import likeliest
from service.gap.fitting.predict import answer, control, measured, residual, weights
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import SIGNIFICANT
from service.report.figure import (
    BAD,
    FOURTH,
    GOOD,
    MEASURED,
    MODEL,
    SECOND,
    Figure,
    Real,
    Trace,
    line,
    log_magnitude,
    points,
)
from service.report.format import MISSING
from sim.rig import Rig
from sim.wording import in_words

Complex = NDArray[np.complex128]

BEFORE, AFTER, FLOOR = "twin before", "twin after", "noise floor"
SIGNALS = ("u", "i", "y")
BLOCKS = {"u": "controller: u", "i": "amplifier: i", "y": "plant: y"}
SIGNAL_OF = {"controller": 0, "amplifier": 1, "plant": 2, "additive": 2}
HEAT = [[0.0, "#f4f7fa"], [0.25, "#cfe0ee"], [0.5, "#7fb2d6"], [0.75, "#e08a4f"], [1.0, "#a8261c"]]
LARGEST_SIGMA = 1000.0
"""Where the colours of the heat maps end."""
SHARP = 2.0
"""Times what nearly all values stay below, from which the largest is a sharp peak, or a bad point, and may be cut."""
LONGEST_BAR = 60.0
"""Standard deviations where the bars of harmonics end."""


@dataclass(frozen=True)
class Compared:
    """One sweep with the twin before and after, all at the excited frequency; (P, 3 n) each."""

    o: Observation
    measured: Complex
    before: Complex
    after: Complex
    sigma: Real
    """Standard deviation of the complex values."""
    z_before: Complex
    """Weighted residuals, (P, H, 3 n), real and imaginary part of unit variance for a right twin."""
    z_after: Complex

    @property
    def n(self) -> int:
        """Number of axes."""
        return int(self.o.U.shape[2])

    @property
    def titles(self) -> list[str]:
        """Of the twins to show: one where the verdict adds nothing."""
        return ["before", "after"] if self.changed else ["twin"]

    @property
    def residuals(self) -> list[Complex]:
        """Of the twins to show."""
        return [self.z_before, self.z_after][: len(self.titles)]

    @property
    def changed(self) -> bool:
        """Whether the verdict adds anything to the twin."""
        return not np.array_equal(self.before, self.after)


def compared(before: Rig, after: Rig, o: Observation) -> Compared:
    """A sweep held against two twins."""
    f, w = o.fundamental, weights(o)[:, o.fundamental]
    predicted = [np.concatenate([control(rig, o), answer(rig, o)], axis=2)[:, f] for rig in (before, after)]
    sigma = np.where(w > 0, np.sqrt(2) / np.maximum(w, 1e-300), np.nan)
    return Compared(o, measured(o)[:, f], predicted[0], predicted[1], sigma, residual(before, o), residual(after, o))


def _shown_signals(o: Observation) -> list[int]:
    return [k for k in range(3) if k != 1 or o.I is not None]


def gap_figure(c: Compared) -> Figure:
    """Relative distance of measured and twin by frequency, block by block, before and after, with the noise floor."""
    shown = _shown_signals(c.o)
    fig = Figure("gap", 1, len(shown), 360, titles=[BLOCKS[SIGNALS[k]] for k in shown], column_gap=0.07)
    hz, count = c.o.frequency_hz, len(c.o.frequency_hz)
    for column, k in enumerate(shown):
        part = slice(k * c.n, (k + 1) * c.n)
        size = np.bincount(c.o.line, (np.abs(c.measured[:, part]) ** 2).sum(axis=1), count)

        errors = (c.measured - c.before, c.measured - c.after, np.nan_to_num(c.sigma))
        before, after, floor = (
            100
            * np.sqrt(np.bincount(c.o.line, (np.abs(e[:, part]) ** 2).sum(axis=1), count) / np.maximum(size, 1e-300))
            for e in errors
        )
        fig.add(0, column, line(hz, floor, FLOOR, MEASURED, dash="dot"))
        fig.add(0, column, line(hz, before, BEFORE if c.changed else "twin", SECOND))
        if c.changed:
            fig.add(0, column, line(hz, after, AFTER, MODEL))
        fig.y(0, column, **log_magnitude([before, after, floor], floor=1e-5))
        fig.frequency(0, column, float(hz[0]), float(hz[-1]))
    fig.y(0, 0, title="‖measured − twin‖ / ‖measured‖, %")
    return fig


def ratio_figure(c: Compared, path: str, axes: tuple[str, ...]) -> Figure:
    """The excited axis's own signal over the twin before: what the twin lacks, and what the effect supplies.

    Rows are magnitude and phase of the quotient, columns the axes that were excited. A right twin lies on one and on
    nought.
    """
    k = SIGNAL_OF[path] if SIGNAL_OF[path] in _shown_signals(c.o) else 2
    signal = SIGNALS[k]
    excited = np.unique(c.o.axis)
    titles = [f"{signal}<sub>{axes[a]}</sub>" for a in excited]
    fig = Figure("quotient", 2, len(excited), 430, titles=titles, column_gap=0.05)
    magnitudes: list[list[Real]] = [[], []]
    phases: list[list[Real]] = [[], []]
    for column, axis in enumerate(excited):
        rows = np.flatnonzero(c.o.axis == axis)
        rows = rows[np.argsort(c.o.points_hz[rows])]
        hz, channel = c.o.points_hz[rows], k * c.n + axis
        was = c.before[rows, channel]
        seen, now = c.measured[rows, channel] / was, c.after[rows, channel] / was
        noise = c.sigma[rows, channel] / np.abs(was)
        bar = {"visible": True, "array": 2.58 * noise / np.sqrt(2), "width": 0, "thickness": 1, "color": "#b8c1ca"}
        fig.add(0, column, points(hz, np.abs(seen), "measured over twin before", error_y=bar))
        if c.changed:
            fig.add(0, column, line(hz, np.abs(now), "twin after over before", MODEL))
        turn = {**bar, "array": np.degrees(bar["array"])}
        fig.add(1, column, points(hz, np.degrees(np.angle(seen)), "measured over twin before", error_y=turn))
        if c.changed:
            fig.add(1, column, line(hz, np.degrees(np.angle(now)), "twin after over before", MODEL))
        for which, value in enumerate((seen, now)):
            magnitudes[which].append(np.abs(value) - 1)
            phases[which].append(np.degrees(np.angle(value)))
        for r in range(2):
            fig.frequency(r, column, float(hz[0]), float(hz[-1]), title=r == 1)
        fig.share_x(column)
    reach, turned = _reach(magnitudes, 0.002), _reach(phases, 0.1)
    for column in range(len(excited)):
        fig.y(0, column, range=[1 - reach, 1 + reach], nticks=6, showticklabels=column == 0)
        fig.y(1, column, range=[-turned, turned], nticks=6, showticklabels=column == 0)
    fig.y(0, 0, title="magnitude")
    fig.y(1, 0, title="phase, deg")
    return fig


def _reach(values: list[list[Real]], least: float) -> float:
    """Half the width of an axis that shows all of the twin but for sharp peaks, and all but a few measured values."""
    out = least
    for group, share in zip(values, (0.95, 0.97), strict=True):
        every = np.abs(np.concatenate(group))
        every = every[np.isfinite(every)]
        if len(every):
            most, largest = float(np.quantile(every, share)), float(every.max())
            out = max(out, largest if largest < SHARP * most else most)
    return 1.15 * out


def heat_figure(c: Compared, axes: tuple[str, ...], bands: int = 8) -> Figure:
    """Residual over noise by signal and axis (rows) and frequency band (columns), before and after."""
    shown = _shown_signals(c.o)
    edges = np.geomspace(c.o.frequency_hz[0] * 0.999, c.o.frequency_hz[-1] * 1.001, bands + 1)
    which = np.clip(np.searchsorted(edges, c.o.points_hz, side="right") - 1, 0, bands - 1)
    rows = [(SIGNALS[k], a, k * c.n + j) for k in shown for j, a in enumerate(axes)]
    fig = Figure("residuals", 1, len(c.titles), 110 + 24 * len(rows), titles=c.titles, legend=False, column_gap=0.05)
    labels = [f"{signal} {axis}" for signal, axis, _ in rows]
    names = [f"{_hz(a)}–{_hz(b)}" for a, b in itertools.pairwise(edges)]
    for column, z in enumerate(c.residuals):
        size = np.full((len(rows), bands), np.nan)
        power = np.abs(z[:, c.o.fundamental]) ** 2 / 2
        for b in range(bands):
            inside = which == b
            if inside.any():
                size[:, b] = np.sqrt(power[inside].mean(axis=0))[[channel for _, _, channel in rows]]
        fig.add(0, column, _heat(names, labels, size, bar=column + 1 == len(c.residuals)))
        fig.y(0, column, autorange="reversed", showticklabels=column == 0, showgrid=False)
        fig.x(0, column, title={"text": "band, Hz", "standoff": 6}, showgrid=False, tickangle=0, tickfont={"size": 10})
    fig.layout["margin"]["r"] = 84
    return fig


def channel_figure(c: Compared, path: str, axes: tuple[str, ...]) -> Figure:
    """Residual over noise by output (rows) and excited axis (columns) of the blamed block, before and after."""
    k = SIGNAL_OF[path] if SIGNAL_OF[path] in _shown_signals(c.o) else 2
    fig = Figure("channels", 1, len(c.titles), 300, titles=c.titles, legend=False, column_gap=0.05)
    excited = sorted(set(c.o.axis.tolist()))
    for column, z in enumerate(c.residuals):
        power = np.abs(z[:, c.o.fundamental, k * c.n : (k + 1) * c.n]) ** 2 / 2
        size = np.sqrt(np.array([power[c.o.axis == b].mean(axis=0) for b in excited]).T)
        bar = column + 1 == len(c.residuals)
        trace = _heat([f"from {axes[b]}" for b in excited], [f"{SIGNALS[k]} {a}" for a in axes], size, bar)
        fig.add(0, column, trace)
        fig.y(0, column, autorange="reversed", showticklabels=column == 0, showgrid=False)
        fig.x(0, column, showgrid=False)
    fig.layout["margin"]["r"] = 84
    return fig


def _heat(x: list[str], y: list[str], size: Real, bar: bool) -> Trace:
    text = [[MISSING if not np.isfinite(v) else f"{v:.1f}" if v < 100 else f"{v:.0f}" for v in row] for row in size]
    decades = np.log10(np.clip(size, 1.0, LARGEST_SIGMA))
    return {
        "type": "heatmap",
        "x": x,
        "y": y,
        "z": [row.tolist() for row in decades],
        "text": text,
        "texttemplate": "%{text}",
        "textfont": {"size": 11},
        "hovertemplate": "%{y}, %{x}: %{text} times the noise<extra></extra>",
        "colorscale": HEAT,
        "zmin": 0.0,
        "zmax": np.log10(LARGEST_SIGMA),
        "xgap": 1,
        "ygap": 1,
        "showscale": bar,
        "colorbar": {
            "title": {"text": "× noise", "side": "top"},
            "tickvals": [0, 1, 2, 3],
            "ticktext": ["1", "10", "100", "1000"],
            "thickness": 12,
            "len": 1.0,
        },
    }


def _hz(value: float) -> str:
    return f"{value:.0f}" if value >= 20 else f"{value:.1f}"


def candidate_figure(d: Diagnosis, document: Mapping[str, Any], most: int = 8) -> Figure | None:
    """Probability and closure of the likeliest candidates, the one that is named first; None without any."""
    best = likeliest(document)[:most]
    if not best:
        return None
    names = [_in_lines([in_words(e) for e in c["effect"].split("+")]) for c in best]
    height = 96 + max(36, 4 + 16 * max(name.count("<br>") + 1 for name in names)) * len(best)
    fig = Figure("candidates", 1, 2, height, titles=["probability", "closure on unseen data"], legend=False)
    fig.layout["margin"]["l"] = 210
    probability = np.array([100 * c["probability"] for c in best])
    closure = np.array([np.nan if c["closure"] is None else 100 * c["closure"] for c in best])
    blamed = set(d.verdict.effects)
    for column, values in enumerate((probability, np.maximum(closure, 0.0))):
        said = probability if column == 0 else closure
        fig.add(
            0,
            column,
            {
                "type": "bar",
                "orientation": "h",
                "x": np.nan_to_num(values),
                "y": list(range(len(best))),
                "marker": {"color": [MODEL if set(c["effects"]) == blamed else "#b8c1ca" for c in best]},
                "text": [
                    _said(float(v), column == 1 and bool(c["open_strength"])) for v, c in zip(said, best, strict=True)
                ],
                "textposition": "outside",
                "cliponaxis": False,
                "hoverinfo": "skip",
            },
        )
        fig.x(0, column, range=[0, 118], tickvals=[0, 25, 50, 75, 100], title={"text": "%", "standoff": 2})
        ticks = {"tickvals": list(range(len(best))), "ticktext": names, "showticklabels": column == 0}
        fig.y(0, column, range=[len(best) - 0.4, -0.6], showgrid=False, **ticks)
    return fig


def _in_lines(effects: list[str], widest: int = 29) -> str:
    """Effects joined by +, on as many lines as the width of the labels asks for."""
    lines = [effects[0]]
    for effect in effects[1:]:
        if len(lines[-1]) + len(effect) + 3 > widest:
            lines.append(f"+ {effect}")
        else:
            lines[-1] += f" + {effect}"
    return "<br>".join(lines)


def _said(percent: float, open_strength: bool) -> str:
    if not np.isfinite(percent) and open_strength:
        return "not shown by the fitted data"
    if not np.isfinite(percent):
        return "not computed"
    return f"{percent:z.0f} %" if percent > -0.5 else "none, it gets worse"


def amplitude_figure(cases: list[tuple[str, Compared]], path: str) -> Figure:
    """Does the gap depend on the amplitude: relative error of every point against the current that made it."""
    titles = cases[0][1].titles
    fig = Figure("amplitude", 1, len(titles), 350, titles=titles)
    largest: list[Real] = []
    smallest: list[Real] = []
    for (name, c), colour in zip(cases, (SECOND, FOURTH), strict=False):
        k = SIGNAL_OF[path] if SIGNAL_OF[path] in _shown_signals(c.o) else 2
        rows = np.arange(len(c.o.axis))
        channel = k * c.n + c.o.axis
        drive = c.o.U if c.o.I is None else c.o.I
        amplitude = np.abs(drive[rows, c.o.fundamental, c.o.axis])
        for column, twin in enumerate((c.before, c.after)[: len(titles)]):
            error = 100 * np.abs(c.measured[rows, channel] / twin[rows, channel] - 1)
            fig.add(0, column, points(amplitude, error, name, colour, size=4))
            largest.append(error)
        smallest.append(amplitude)
    for column in range(len(titles)):
        fig.x(0, column, title={"text": "current of the excited axis, A", "standoff": 6}, **log_magnitude(smallest))
        fig.y(0, column, **log_magnitude(largest, floor=1e-4), showticklabels=column == 0)
    fig.y(0, 0, title="difference from the twin, %")
    return fig


def harmonic_figure(d: Diagnosis) -> Figure | None:
    """Harmonics that the twin's own magnets do not explain, as significance; None where none was measured."""
    found = d.where.harmonics
    if not found:
        return None
    fig = Figure("harmonics", 1, 1, 260, legend=False)
    names = [f"{signal}, harmonic {h}" for signal, h, _ in found]
    values = np.array([min(s, LONGEST_BAR) for _, _, s in found])
    colours = [BAD if s > SIGNIFICANT else GOOD for s in values]
    fig.add(
        0,
        0,
        {
            "type": "bar",
            "x": names,
            "y": values,
            "marker": {"color": colours},
            "text": [f"{s:.1f}" for _, _, s in found],
            "textposition": "outside",
            "cliponaxis": False,
            "hoverinfo": "skip",
            "width": 0.5,
        },
    )
    fig.line_at(0, 0, y=SIGNIFICANT, text=f"significant above {SIGNIFICANT:g}", colour=BAD, left=True)
    fig.y(0, 0, title="standard deviations", range=[0, max(8.0, 1.25 * float(values.max(initial=0.0)))])
    return fig


def nu_gap_figure(document: dict[str, object]) -> Figure | None:
    """Pointwise nu-gap of the loop by frequency, before and after; None where it could not be computed."""
    loop = document.get("loop")
    found = loop.get("nu_gap") if isinstance(loop, dict) else None
    if not found:
        return None
    fig = Figure("nu-gap", 1, 1, 300)
    hz = np.array(found["frequency_hz"])
    before, after = np.array(found["before"]), np.array(found["after"])
    fig.add(0, 0, line(hz, before, BEFORE, SECOND))
    fig.add(0, 0, line(hz, after, AFTER, MODEL))
    fig.frequency(0, 0, float(hz[0]), float(hz[-1]))
    fig.y(0, 0, title="ν-gap", **log_magnitude([before, after]))
    return fig
