"""Is the model right: residuals against their noise (Figures 5.9 to 5.12 of the thesis), and the map of the poles."""

from __future__ import annotations

import math

import numpy as np

from service.distributions import chi2_above
from service.identification.result.commissioning import PlaneResult
from service.identification.result.parts import RootResult
from service.identification.statistics.validation import CorrelationTest
from service.report.bode import RADIUS_99
from service.report.figure import MODEL, REGION, SECOND, THIRD, Figure, band, line, points
from service.report.format import fixed, number, table
from sim.wording import in_words


def residual_figure(plane: PlaneResult) -> Figure:
    """Whiteness and independence of the displacement's residuals, entry by entry, with 99 % bounds."""
    kinds = [("whiteness", plane.tests["whiteness"]), ("independence", plane.tests["independence"])]
    columns = max(1, len(kinds[0][1]))
    titles = [in_words(t.name) for t in kinds[0][1]]
    fig = Figure(
        f"residuals-{plane.plane}", 2, columns, 430, titles=titles, column_gap=0.04, row_gap_px=56, weights=(1, 1)
    )
    largest = max([0.2, *(float(np.max(np.abs(t.correlation), initial=0.0)) * 1.15 for _, ts in kinds for t in ts)])
    for r, (_, tests) in enumerate(kinds):
        for c, test in enumerate(tests):
            _stems(fig, r, c, test)
            fig.y(r, c, range=[-largest, largest], showticklabels=c == 0)
            fig.x(r, c, title={"text": "lag, lines", "standoff": 4}, showticklabels=True)
        fig.y(r, 0, title=("correlation with itself", "with the model")[r])
    return fig


def _stems(fig: Figure, row: int, column: int, test: CorrelationTest) -> None:
    low, high = float(test.lags[0]) - 0.7, float(test.lags[-1]) + 0.7
    edge, bound = np.array([low, high]), np.full(2, test.bound)
    fig.add(row, column, band(edge, -bound, bound, "99 % bound"))
    x = np.repeat(test.lags, 3)
    y = np.column_stack([np.zeros_like(test.correlation), test.correlation, np.full(len(test.lags), np.nan)]).ravel()
    fig.add(row, column, line(x, y, "stems", MODEL, width=1.2, showlegend=False, hoverinfo="skip"))
    fig.add(row, column, points(test.lags, test.correlation, "correlation", MODEL, size=5))
    fig.x(row, column, range=[low, high])


def tests_table(plane: PlaneResult) -> str:
    """p-values of both tests and the size of the residuals, entry by entry."""
    rows = [
        [in_words(t.name), kind, number(t.statistic, 4), str(t.degrees_of_freedom), number(t.p_value, 2)]
        for kind, tests in plane.tests.items()
        for t in tests
    ]
    head = ["entry", "test", "statistic", "degrees of freedom", "p"]
    signals = [f"{s} {a}" for s in ("iy" if len(plane.residual_rms) == 4 else "y") for a in plane.axes]
    sizes = [[name, *(fixed(v, 2) for v in row)] for name, row in zip(signals, plane.residual_rms, strict=True)]
    return (
        '<div class="side">'
        + table(head, rows, left=2)
        + table(["residual over noise, rms", *(f"from {a}" for a in plane.axes)], sizes)
        + "</div>"
    )


def pole_figure(plane: PlaneResult) -> Figure:
    """Poles and zeros of the levitated plant: the rigid pairs on the real axis, and every flexible pole near by."""
    poles = np.array([p.value for p in plane.poles])
    zeros = np.array([z.value for z in plane.zeros], dtype=complex)
    flexible = [k for k, p in enumerate(poles) if p.imag > 1e-6 * max(abs(p), 1.0)]
    flexible.sort(key=lambda k: poles[k].imag)
    flexible = flexible[:3]
    titles = ["all of them", *(f"near {poles[k].imag:.0f} rad/s" for k in flexible)]
    fig = Figure(f"poles-{plane.plane}", 1, 1 + len(flexible), 340, titles=titles, column_gap=0.085)
    pole_style = {"symbol": "x-thin", "size": 10, "stroke": 2}
    zero_style = {"symbol": "circle-open", "size": 8, "stroke": 1.6}
    fig.add(0, 0, points(poles.real, poles.imag, "pole", MODEL, **pole_style))
    fig.add(0, 0, points(zeros.real, zeros.imag, "transmission zero", THIRD, **zero_style))
    fig.line_at(0, 0, x=0.0, colour="#9aa5b1")
    fig.x(0, 0, title={"text": "real part, rad/s", "standoff": 6})
    fig.y(0, 0, title="imaginary part, rad/s")
    for c, k in enumerate(flexible, start=1):
        p = poles[k]
        reach = 4.0 * RADIUS_99 * plane.poles[k].std
        _region(fig, c, plane.poles[k], "99 % region", MODEL)
        fig.add(0, c, points(np.array([p.real]), np.array([p.imag]), "pole", MODEL, **pole_style))
        near = [z for z in plane.zeros if abs(z.value - p) < 1.4 * reach]
        for z in near:
            _region(fig, c, z, "99 % region of a zero", THIRD)
        if near:
            at = np.array([z.value for z in near])
            fig.add(0, c, points(at.real, at.imag, "transmission zero", THIRD, **zero_style))
        fig.x(0, c, range=[p.real - reach, p.real + reach], title={"text": "real part, rad/s", "standoff": 6}, nticks=4)
        fig.y(0, c, range=[p.imag - reach, p.imag + reach], nticks=6)
        if p.real + reach > 0:
            fig.line_at(0, c, x=0.0, colour=SECOND)
    return fig


def _region(fig: Figure, column: int, root: RootResult, name: str, colour: str) -> None:
    """The ellipse within which a root lies at 99 %."""
    sizes, axes = np.linalg.eigh(root.covariance)
    turn = np.linspace(0, 2 * np.pi, 61)
    radius = math.sqrt(chi2_above(0.01, 2)) * np.sqrt(np.maximum(sizes, 0.0))
    x, y = axes @ (radius[:, None] * np.array([np.cos(turn), np.sin(turn)]))
    shape = {"fill": "toself", "fillcolor": REGION, "hoverinfo": "skip"}
    fig.add(0, column, line(root.value.real + x, root.value.imag + y, name, colour, width=1.0, **shape))


def correlation_figure(plane: PlaneResult) -> Figure:
    """How the errors of all figures go together."""
    names = list(plane.correlations.names)
    fig = Figure(f"correlations-{plane.plane}", 1, 1, 150 + 19 * len(names), titles=[], legend=False)
    z = plane.correlations.matrix
    trace = {
        "type": "heatmap",
        "x": names,
        "y": names,
        "z": [[round(float(v), 3) for v in row] for row in z],
        "hovertemplate": "%{y}, %{x}: %{z:.2f}<extra></extra>",
        "colorscale": [[0.0, SECOND], [0.5, "#ffffff"], [1.0, MODEL]],
        "zmin": -1.0,
        "zmax": 1.0,
        "xgap": 1,
        "ygap": 1,
        "colorbar": {"thickness": 12, "len": 1.0, "tickvals": [-1, 0, 1]},
    }
    fig.add(0, 0, trace)
    fig.y(0, 0, autorange="reversed", showgrid=False, tickfont={"size": 10})
    fig.x(0, 0, showgrid=False, tickangle=-60, tickfont={"size": 10})
    fig.layout["margin"].update(l=150, b=130, r=60)
    return fig


def pole_table(plane: PlaneResult) -> str:
    """Poles and zeros of the levitated plant with their uncertainty, and the black box's pole nearest to each pole."""
    rows = []
    others = plane.subspace.poles
    for p in (*plane.poles, *plane.zeros):
        if p.value.imag < -1e-9:
            continue
        w, pole = abs(p.value), any(p is other for other in plane.poles)
        rows.append(
            [
                "pole" if pole else "zero",
                number(p.value.real, 5),
                "0" if p.value.imag == 0 else f"± {number(p.value.imag, 7)}",
                number(p.std, 2),
                number(w / (2 * np.pi), 6),
                _complex(others[np.argmin(np.abs(others - p.value))]) if pole and len(others) else "",
                "unstable" if pole and p.value.real > 0 else "",
            ]
        )
    return table(
        ["", "real, rad/s", "imaginary, rad/s", "std. dev., rad/s", "|p|, Hz", "subspace, rad/s", ""], rows, left=1
    )


def _complex(value: complex) -> str:
    imaginary = f" ± {number(abs(value.imag), 6)}j" if abs(value.imag) > 1e-6 * abs(value) else ""
    return f"{number(value.real, 4)}{imaginary}"
