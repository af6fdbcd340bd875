"""Page of a health check: what drifted, how sure that is, and how every figure went over the checks so far."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from service.health.trend import Checked, Series, trend
from service.health.zones import zone_is_calm
from service.report.figure import BAD, GRID, MEASURED, MODEL, Figure, points
from service.report.format import MISSING, change, count, figures, fixed, in_unit, moment, paragraph, signed, table
from service.report.page import Captioned, Page, Section, Tone

GROUPS = (
    ("magnets", "Magnets", ("ki", "ks")),
    ("modes", "Flexible modes", ("wn", "zeta")),
    ("amplifiers", "Amplifiers", ("amplifier",)),
    ("margin", "Sensitivity peaks", ("sensitivity",)),
)
COLUMNS = 4


def health_page(document: Mapping[str, Any], history: Sequence[Checked]) -> str:
    """The page as one self-contained file.

    Parameters
    ----------
    document
        Of the check, ``amb-health-check``.
    history
        All checks of the rig up to this one, itself included.
    """
    tone: Tone = "bad" if document["alarm"] else "good" if zone_is_calm(document) else "warn"
    series = trend(history)
    drifting = [n for n, s in series.items() if s.drifting and n not in document["drifted"]]
    notes = [f"{n} changes steadily over the checks, although no single one shows it" for n in drifting]
    notes += document.get("notes", [])
    at = document.get("checked_at")
    about = f"Checked {moment(at) if at else 'at an unknown time'}"
    if document["rig_seconds"]:
        about += f"; the rig was busy for {document['rig_seconds']:.0f} s"
    return Page(
        f"Health of {document['rig']}",
        about,
        headline(document),
        tone,
        notes,
        [_changes(document), _margins(document), _history(series, len(history)), _method(document)],
    ).html()


def headline(document: Mapping[str, Any]) -> str:
    """A check in one sentence, that names the rig and says whether it is an alarm."""
    return ("ALARM: " if document["alarm"] else "") + str(document["sentence"])


def _changes(document: Mapping[str, Any]) -> Section:
    rows = []
    for name, p in document["parameters"].items():
        was, was_std = figures(p["baseline"]["value"], p["baseline"]["std"])
        now, now_std = figures(p["now"]["value"], p["now"]["std"])
        mark = "drifted" if p["drifted"] else ""
        by = change(p["change_percent"], p["change_std_percent"])
        rows.append([in_unit(name, p["unit"]), was, was_std, now, now_std, by, signed(p["significance"], 1), mark])
    head = ["figure", "commissioned", "std", "now", "std", "change, %", "in std. dev.", ""]
    text = (
        f"A change is an alarm beyond {_thresholds(document)} standard deviations of check and commissioning together: "
        f"with {count(document['tests_made'], 'check')} of this rig in the year before, that keeps the expected number "
        f"of false alarms below {document['false_alarms_per_year']:g} a year over all figures."
    )
    return Section("Figures", [table(head, rows), paragraph(text)])


def _thresholds(document: Mapping[str, Any]) -> str:
    """Of every plane that has another one: its data may be fewer, and tails of few data are longer."""
    of: dict[str, list[str]] = {}
    for p in document["parameters"].values():
        planes = of.setdefault(f"{p['threshold']:.2f}", [])
        if p["plane"] not in planes:
            planes.append(p["plane"])
    if len(of) < 2:
        return next(iter(of), "0.00")
    return " and ".join(f"{limit} ({', '.join(f'{p}-plane' for p in planes)})" for limit, planes in of.items())


def _margins(document: Mapping[str, Any]) -> Section:
    rows = [[axis, *_peak(p), fixed(p["measured"], 2), p["zone"]] for axis, p in document["sensitivity_peak"].items()]
    head = ["axis", "peak of |S|", "std", "largest measured", "zone"]
    note = "The largest measured value is one of the check's few tones, so the peak is at least that high."
    if any(law["differs"] for law in document.get("controller", {}).values()):
        note += " The model's loop has the controller of the commissioning, and tells nothing where another one ran."
    return Section("Stability margin", [table(head, rows), paragraph(note)])


def _peak(peak: Mapping[str, Any]) -> tuple[str, str]:
    return (MISSING, MISSING) if peak["value"] is None else figures(peak["value"], peak["std"])


def _history(series: Mapping[str, Series], n: int) -> Section:
    if n < 2:
        return Section("Trend", [paragraph("This is the first check: a trend needs more of them.")])
    parts = []
    for name, title, prefixes in GROUPS:
        chosen = {k: s for k, s in series.items() if k.split(".", 1)[-1].startswith(prefixes)}
        if chosen:
            parts.append(Captioned(trend_figure(f"trend-{name}", chosen), f"{title}: change against the baseline."))
    rows = [
        [
            k,
            change(s.slope_percent_per_year, s.slope_std or 0.0),
            signed(s.significance, 1),
            "steady" if s.drifting else "",
        ]
        for k, s in series.items()
        if s.slope_percent_per_year is not None
    ]
    tables = [table(["figure", "slope, % a year", "in std. dev.", ""], rows)] if rows else []
    return Section("Trend", [*parts, *tables])


def trend_figure(name: str, chosen: Mapping[str, Series]) -> Figure:
    """Change of some figures over time, percent, each in its panel, with one standard deviation."""
    columns = min(COLUMNS, len(chosen))
    rows = -(-len(chosen) // columns)
    figure = Figure(name, rows, columns, 90 + 170 * rows, titles=list(chosen), legend=False, column_gap=0.075)
    for k, s in enumerate(chosen.values()):
        r, c = divmod(k, columns)
        times = np.array([a.isoformat() for a in s.at])
        wide = s.baseline_std_percent
        figure.line_at(r, c, y=0.0, colour=GRID)
        colours = [BAD if d else MODEL for d in s.drifted]
        trace = points(times, s.change_percent, s.name, MEASURED, size=5)
        trace["marker"]["color"] = colours
        trace["error_y"] = {
            "type": "data",
            "array": np.hypot(s.std_percent, wide),
            "thickness": 1,
            "width": 0,
            "color": "#9aa5b1",
        }
        figure.add(r, c, trace)
        figure.x(r, c, type="date", nticks=3)
        figure.y(r, c, title="%" if c == 0 else "", nticks=5, exponentformat="none")
    return figure


def _method(document: Mapping[str, Any]) -> Section:
    tones = ", ".join(f"{f:.4g}" for f in document["frequencies_hz"])
    fits = "; ".join(
        f"plane {name}: residuals {r['rms_over_sigma']:.2f} times the noise"
        for name, r in document["residuals"].items()
    )
    return Section("Method", [paragraph(f"Tones at {tones} Hz. {fits}.")])
