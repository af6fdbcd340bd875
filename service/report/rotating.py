"""The part of a report that tells of the rotor at speed: gyroscopic figures and the Campbell diagram."""

from __future__ import annotations

import numpy as np

from service.identification.rotating.campbell import Branch
from service.identification.rotating.turned import Turned
from service.report.figure import FOURTH, MODEL, SECOND, THIRD, Figure, band, line
from service.report.format import figures, fixed, number, paragraph, table
from service.report.page import Captioned, Section
from sim.wording import in_words, times

COLOUR = {"forward": MODEL, "backward": SECOND, "planar": FOURTH}
SHADE = {"forward": "rgba(0,114,178,0.22)", "backward": "rgba(213,94,0,0.22)", "planar": "rgba(204,121,167,0.25)"}
SIGMAS = 1.96


def rotating_section(turned: Turned) -> Section:
    """Inertias, couplings, Campbell diagram, critical speeds and what was done about synchronous lines."""
    parts: list[str | Captioned] = [paragraph(text, "note") for text in doubts(turned)]
    parts += ['<div class="side">', _inertias(turned), _modes(turned), "</div>"]
    parts.append(
        Captioned(
            campbell_figure(turned),
            "Campbell diagram of the running loop: whirls that ring, their damping, and below each flexible mode by "
            "itself with that of the free rotor dashed. Bands are 95 % intervals; beyond the fastest measured speed "
            "the model goes on alone.",
        )
    )
    critical = [
        [
            fixed(c.speed_rad_s * 30 / np.pi, 1),
            fixed(SIGMAS * c.std * 30 / np.pi, 2),
            c.direction,
            fixed(c.damping_ratio, 3),
        ]
        for c in turned.campbell.critical
    ]
    if critical:
        parts.append(table(["critical speed, rev/min", "± (95 %)", "whirl", "ζ"], critical))
    else:
        parts.append(paragraph("No whirl that rings meets the synchronous line within the diagram."))
    parts.append(_sweeps(turned))
    agreement = ""
    if turned.apart is not None:
        agreement = (
            f" ki and ks agree with those of the planes by themselves within {turned.apart:.1f} standard deviations."
        )
    parts.append(
        paragraph(
            "One model G(s, Ω) of all four axes is fitted to every speed together. Inertias are in proportion to the "
            "mass, which is given; g is the gyroscopic coupling of a mode's two planes, which splits its whirls by gΩ; "
            "damping that turns with the shaft takes from the forward whirl what it adds to the backward one."
            + agreement,
            "small",
        )
    )
    return Section("Rotor at speed", parts)


def doubts(turned: Turned) -> list[str]:
    """What a reader of any figure of this section has to know first."""
    found = list(turned.refined.fit.doubt)
    if not turned.uncertainty.adequate:
        found.insert(
            0,
            f"The turning rotor does not behave as this model: over all speeds the residuals are "
            f"{times(turned.uncertainty.scale)} times the noise, so something acts that it does not have. Its "
            "figures are the best that such a model has; their deviations are widened, not freed of a bias.",
        )
    return found


def _inertias(turned: Turned) -> str:
    rows = []
    for name, label, unit in (
        ("polar_inertia_kgm2", "polar inertia", "kg m²"),
        ("transverse_inertia_kgm2", "transverse inertia", "kg m²"),
        ("centre_of_gravity_m", "centre of gravity, towards A", "m"),
    ):
        e = turned.estimate(name, unit)
        rows.append([f"{label}, {unit}", *figures(e.value, e.std)])
    for name, e in turned.stiffness().items():
        rows.append([f"{in_words(name)}, {e.unit}", *figures(e.value, e.std)])
    return table(["all speeds together", "identified", "std. dev."], rows)


def _modes(turned: Turned) -> str:
    rows = []
    for k in range(len(turned.model.layout.pairs)):
        g, rotating, (w_x, w_y, _, _) = turned.pair_figures(k)
        rows.append(
            [
                f"{0.5 * (w_x.value + w_y.value) / (2 * np.pi):.2f}",
                *figures(g.value, g.std),
                *figures(rotating.value, rotating.std),
            ]
        )
    return table(["flexible mode, Hz", "g", "std. dev.", "turning damping ratio", "std. dev."], rows)


def _sweeps(turned: Turned) -> str:
    rows = []
    for points, rms in zip(turned.data, turned.rms, strict=True):
        seen = [line for line in points.lines if line.seen]
        rows.append(
            [
                points.name,
                fixed(points.speed_rad_s * 30 / np.pi, 0),
                str(len(points.omega)),
                fixed(float(rms), 2),
                ", ".join(f"{s.order}×: {number(1e6 * float(np.max(s.amplitude_m)), 2)} µm" for s in seen) or "none",
                str(sum(s.notched for s in seen)),
                str(sum(s.left_out for s in points.lines)),
            ]
        )
    head = ["sweep", "rev/min", "points", "residual / noise", "synchronous lines in y", "notched", "left out"]
    return table(head, rows)


def campbell_figure(turned: Turned) -> Figure:
    """Frequencies and damping over the speed, and each flexible mode by itself."""
    diagram = turned.campbell
    hz = np.abs(diagram.speed_rad_s) / (2 * np.pi)
    planes = turned.model.planes
    pairs = [0.5 * (planes[0].modes[a, 0] + planes[1].modes[b, 0]) for a, b in turned.model.layout.pairs]
    titles = ["all whirls", "damping", *(f"flexible mode {k + 1}" for k in range(len(pairs)))]
    rows = 1 + (len(pairs) + 1) // 2
    titles += [""] * (2 * rows - len(titles))
    fig = Figure("campbell", rows, 2, 120 + 290 * rows, titles=titles)
    for branch in diagram.levitated:
        _draw(fig, 0, 0, hz, branch, branch.frequency, branch.frequency_std, 2 * np.pi)
        _draw(fig, 0, 1, hz, branch, branch.damping_ratio, branch.damping_std, 1.0)
    fig.add(0, 0, line(hz, hz, "once a turn", THIRD, dash="dot"))
    fig.y(0, 0, title="frequency, Hz")
    fig.y(0, 1, title="damping ratio", type="log", nticks=6)
    for k, nu in enumerate(pairs):
        r, c = 1 + k // 2, k % 2
        for dash, branches in (("solid", diagram.levitated), ("dash", diagram.free)):
            for branch in branches:
                if abs(np.nanmean(branch.frequency) - nu) < 0.06 * nu:
                    _draw(fig, r, c, hz, branch, branch.frequency, branch.frequency_std, 2 * np.pi, dash)
        fig.y(r, c, title="frequency, Hz")
        fig.x(r, c, title={"text": "speed, rev/s", "standoff": 6})
    for p in turned.data:
        for c in range(2):
            fig.line_at(0, c, x=abs(p.speed_rad_s) / (2 * np.pi), colour="#9aa5b1")
    for c in range(2):
        fig.x(0, c, title={"text": "speed, rev/s", "standoff": 6})
    return fig


def _draw(
    fig: Figure,
    row: int,
    column: int,
    hz: np.ndarray,
    branch: Branch,
    value: np.ndarray,
    std: np.ndarray,
    unit: float,
    dash: str = "solid",
) -> None:
    rings = np.isfinite(value)
    x, y, wide = hz[rings], value[rings] / unit, SIGMAS * std[rings] / unit
    name = branch.direction if dash == "solid" else f"{branch.direction}, free rotor"
    if len(x) > 1:
        fig.add(row, column, band(x, y - wide, y + wide, f"{name}, 95 %", SHADE[branch.direction]))
    fig.add(row, column, line(x, y, name, COLOUR[branch.direction], dash=dash))
