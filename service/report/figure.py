"""Figures as plotly's own JSON, built by hand: panels in a grid, axes with units, one look for all of them."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Trace = dict[str, Any]
Axis = dict[str, Any]

INK, GRID = "#1c2733", "#e4e8ec"
MEASURED, MODEL, SECOND, THIRD, FOURTH = "#7b8794", "#0072b2", "#d55e00", "#009e73", "#cc79a7"
REGION = "rgba(0,114,178,0.22)"
AXIS_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
"""One for each axis of a rig."""
BAD, GOOD = "#c0392b", "#2e7d4f"


@dataclass
class Figure:
    """A grid of panels that share a legend above them.

    Parameters
    ----------
    name
        Identifies the figure on its page; letters, digits and dashes.
    rows, columns
        Of panels.
    height_px
        Of the whole figure.
    weights
        Relative heights of the rows, from the top.
    titles
        Above the panels of the first row, or above every panel.
    """

    name: str
    rows: int
    columns: int
    height_px: int
    weights: Sequence[float] = ()
    titles: Sequence[str] = ()
    legend: bool = True
    column_gap: float = 0.09
    row_gap_px: int = 18
    data: list[Trace] = field(default_factory=list)
    layout: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        top = (38 if self.legend else 30) + (24 if self.titles else 0)
        bottom = 46
        inner = self.height_px - top - bottom
        every_row = len(self.titles) > self.columns
        gap = (self.row_gap_px + (44 if every_row else 0)) / inner
        weights = np.array(self.weights or [1.0] * self.rows, dtype=float)
        heights = weights / weights.sum() * (1 - gap * (self.rows - 1))
        width = (1 - self.column_gap * (self.columns - 1)) / self.columns
        self.layout = {
            "height": self.height_px,
            "margin": {"l": 66, "r": 14, "t": top, "b": bottom},
            "paper_bgcolor": "#fff",
            "plot_bgcolor": "#fff",
            "font": {"family": "Helvetica, Arial, sans-serif", "size": 12, "color": INK},
            "hovermode": "closest",
            "separators": ". ",
            "showlegend": self.legend,
            "legend": {
                "orientation": "h",
                "x": 0,
                "xanchor": "left",
                "y": 1 + (22 if self.titles else 4) / inner,
                "yanchor": "bottom",
                "bgcolor": "rgba(0,0,0,0)",
                "itemsizing": "constant",
            },
            "annotations": [],
            "shapes": [],
        }
        above = 1.0
        for r in range(self.rows):
            low = max(0.0, above - heights[r])
            for c in range(self.columns):
                left = c * (width + self.column_gap)
                k = self.number(r, c)
                x, y = self.axis_names(k)
                last = r == self.rows - 1 or every_row
                self.layout[x] = _axis([left, min(1.0, left + width)], anchor=f"y{k or ''}", ticklabels=last)
                self.layout[y] = _axis([low, above], anchor=f"x{k or ''}", ticklabels=True)
                title = self.titles[k - 1 if k else 0] if k - 1 < len(self.titles) and self.titles else ""
                if title:
                    self._title(title, left + width / 2, above)
            above = low - gap

    def number(self, row: int, column: int) -> int:
        """Plotly's number of a panel: none for the first, then 2, 3, ..."""
        k = row * self.columns + column + 1
        return 0 if k == 1 else k

    @staticmethod
    def axis_names(number: int) -> tuple[str, str]:
        """Keys of a panel's axes in the layout."""
        return f"xaxis{number or ''}", f"yaxis{number or ''}"

    def _title(self, text: str, x: float, y: float) -> None:
        self.layout["annotations"].append(
            {
                "text": f"<b>{text}</b>",
                "x": x,
                "y": y,
                "xref": "paper",
                "yref": "paper",
                "xanchor": "center",
                "yanchor": "bottom",
                "yshift": 2,
                "showarrow": False,
                "font": {"size": 12},
            }
        )

    def add(self, row: int, column: int, trace: Trace) -> None:
        """Draw a trace into a panel; one name appears once in the legend."""
        k = self.number(row, column)
        trace = {**trace, "xaxis": f"x{k or ''}", "yaxis": f"y{k or ''}"}
        name = trace.get("name", "")
        known = any(t.get("name") == name and t.get("showlegend") is not False for t in self.data)
        trace["legendgroup"] = name
        if known or not name:
            trace["showlegend"] = False
        self.data.append(trace)

    def x(self, row: int, column: int, **options: Any) -> None:
        """Options of a panel's x axis."""
        self.layout[self.axis_names(self.number(row, column))[0]].update(options)

    def y(self, row: int, column: int, **options: Any) -> None:
        """Options of a panel's y axis."""
        if isinstance(options.get("title"), str):
            options["title"] = {"text": options["title"], "standoff": 8}
        self.layout[self.axis_names(self.number(row, column))[1]].update(options)

    def share_x(self, column: int) -> None:
        """Zoom all panels of a column together."""
        first = self.number(self.rows - 1, column)
        for r in range(self.rows - 1):
            self.x(r, column, matches=f"x{first or ''}")

    def frequency(self, row: int, column: int, low_hz: float, high_hz: float, title: bool = True) -> None:
        """Logarithmic frequency axis in Hz."""
        self.x(row, column, **log_frequency(low_hz, high_hz))
        if title:
            self.x(row, column, title={"text": "frequency, Hz", "standoff": 6})

    def line_at(
        self,
        row: int,
        column: int,
        *,
        x: float | None = None,
        y: float | None = None,
        text: str = "",
        colour: str = SECOND,
        below: bool = False,
        left: bool = False,
    ) -> None:
        """A dashed line across a panel, named at its end; ``below`` and ``left`` say where a horizontal one is named.

        Logarithmic axes must be set before.
        """
        k = self.number(row, column) or ""
        shape: dict[str, Any] = {"type": "line", "line": {"color": colour, "width": 1.2, "dash": "dash"}}
        if y is not None:
            shape |= {"xref": f"x{k} domain", "yref": f"y{k}", "x0": 0, "x1": 1, "y0": y, "y1": y}
        else:
            shape |= {"xref": f"x{k}", "yref": f"y{k} domain", "x0": x, "x1": x, "y0": 0, "y1": 1}
        self.layout["shapes"].append(shape)
        if not text:
            return
        log_x = self.layout[f"xaxis{k}"].get("type") == "log"
        log_y = self.layout[f"yaxis{k}"].get("type") == "log"
        note = {"text": text, "showarrow": False, "font": {"size": 11, "color": colour}}
        if y is not None:
            place = {"x": 0.005 if left else 0.995, "xref": f"x{k} domain", "xanchor": "left" if left else "right"}
            place |= {"y": math.log10(y) if log_y else y, "yref": f"y{k}", "yanchor": "top" if below else "bottom"}
        else:
            assert x is not None
            place = {"x": math.log10(x) if log_x else x, "xref": f"x{k}", "xanchor": "left", "xshift": 3}
            place |= {"y": 0.98, "yref": f"y{k} domain", "yanchor": "top"}
        self.layout["annotations"].append(note | place)

    def document(self) -> dict[str, Any]:
        """As plotly's JSON; everything in it is plain Python."""
        return {"data": [_plain(t) for t in self.data], "layout": _plain(self.layout)}


def _axis(domain: list[float], anchor: str, ticklabels: bool) -> Axis:
    return {
        "domain": [round(float(v), 5) for v in domain],
        "anchor": anchor,
        "showticklabels": ticklabels,
        "showline": True,
        "mirror": True,
        "linecolor": "#9aa5b1",
        "linewidth": 1,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": "#9aa5b1",
        "gridcolor": GRID,
        "zeroline": False,
        "automargin": False,
    }


def log_frequency(low_hz: float, high_hz: float) -> Axis:
    """Axis options: logarithmic, ticks at 1, 2 and 5 of every decade, plain numbers."""
    decades = range(math.floor(math.log10(low_hz)), math.ceil(math.log10(high_hz)) + 1)
    pad = max(0.03 * math.log10(high_hz / low_hz), 0.01)  # one frequency alone is in the middle
    low, high = math.log10(low_hz) - pad, math.log10(high_hz) + pad
    ticks = [m * 10.0**d for d in decades for m in (1, 2, 5) if low <= math.log10(m * 10.0**d) <= high]
    if not ticks:
        return {"type": "log", "range": [low, high], "nticks": 5}
    return {
        "type": "log",
        "range": [low, high],
        "tickvals": ticks,
        "ticktext": [f"{t:.10g}" for t in ticks],
    }


def log_magnitude(values: Sequence[Real], floor: float = 0.0) -> Axis:
    """Axis options: logarithmic over the values, one label a decade, or at 1, 2 and 5 where there are few decades."""
    every = np.concatenate([np.empty(0), *(np.abs(np.asarray(v, dtype=float)).ravel() for v in values)])
    every = every[np.isfinite(every) & (every > floor)]
    if not len(every):
        return {"type": "log"}
    low, high = float(every.min()), float(every.max())
    pad = max(0.05 * math.log10(high / low), 0.03)
    low, high = low * 10**-pad, high * 10**pad
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1,) if math.log10(high / low) > 2.5 else (1, 2, 5)
    ticks = [m * 10.0**d for d in decades for m in steps if low <= m * 10.0**d <= high]
    if len(ticks) < 2:
        return {"type": "log", "range": [math.log10(low), math.log10(high)], "nticks": 5}
    return {
        "type": "log",
        "range": [math.log10(low), math.log10(high)],
        "tickvals": ticks,
        "ticktext": [_tick(t) for t in ticks],
    }


def _tick(value: float) -> str:
    if 1e-3 <= value < 1e5:
        return f"{value:.10g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    mantissa = round(value / 10.0**exponent)
    power = f"10<sup>{exponent}</sup>".replace("-", "−")
    return power if mantissa == 1 else f"{mantissa}·{power}"


def points(x: Real, y: Real, name: str, colour: str = MEASURED, **options: Any) -> Trace:
    """Measured points."""
    symbol, size, stroke = options.pop("symbol", "circle"), options.pop("size", 4), options.pop("stroke", 0)
    return {
        "type": "scatter",
        "mode": "markers",
        "x": x,
        "y": y,
        "name": name,
        "marker": {
            "color": colour,
            "size": size,
            "symbol": symbol,
            "line": {"width": stroke, "color": colour},
        },
        **options,
    }


def line(x: Real, y: Real, name: str, colour: str = MODEL, **options: Any) -> Trace:
    """A curve; a point without a neighbour, of which no line is drawn, gets a marker."""
    style = {"color": colour, "width": options.pop("width", 1.4), "dash": options.pop("dash", "solid")}
    trace = {"type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "line": style, **options}
    if not (alone := _alone(y)).any():
        return trace
    marker = {"color": colour, "size": np.where(alone, 6.0, 0.0), "opacity": 1, "line": {"width": 0}}
    return trace | {"mode": "lines+markers", "marker": marker}


def _alone(y: Real) -> NDArray[np.bool_]:
    """Which values have none beside them."""
    there = np.concatenate([[False], np.isfinite(np.asarray(y, dtype=float)), [False]])
    return np.asarray(there[1:-1] & ~there[:-2] & ~there[2:])


def band(x: Real, low: Real, high: Real, name: str, colour: str = REGION) -> Trace:
    """A filled region between two curves."""
    return {
        "type": "scatter",
        "mode": "lines",
        "x": np.concatenate([x, x[::-1]]),
        "y": np.concatenate([high, low[::-1]]),
        "name": name,
        "fill": "toself",
        "fillcolor": colour,
        "line": {"width": 0},
        "hoverinfo": "skip",
    }


def _plain(value: Any) -> Any:
    """Plain lists and numbers; long arrays packed as single-precision bytes, null for a number that is not finite."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and len(value) > 24:
            kind = "f4" if np.nanmax(np.abs(value)) < 100 * np.nanstd(value) else "f8"
            packed = np.ascontiguousarray(value, dtype=f"<{kind}").tobytes()
            return {"dtype": kind, "bdata": base64.b64encode(packed).decode("ascii")}
        return [_plain(v) for v in value.tolist()]
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
