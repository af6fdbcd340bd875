"""Frequency responses of a plane: amplifiers, the plant with its 99 % region, the staged fits, the sensitivity."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from service.distributions import chi2_above
from service.experiment.data import Experiment
from service.identification.loop.margins import sensitivity
from service.identification.measured.etfe import FrequencyResponse, etfe
from service.identification.measured.points import plane_points
from service.identification.measured.sweeps import chosen_sweeps
from service.identification.plane import amplifier
from service.identification.result.commissioning import PlaneResult
from service.report.figure import (
    FOURTH,
    MEASURED,
    MODEL,
    REGION,
    SECOND,
    THIRD,
    Figure,
    Real,
    band,
    line,
    log_magnitude,
    points,
)
from sim.datasheet import Datasheet
from sim.errors import AmbError

Complex = NDArray[np.complex128]

RADIUS_99 = math.sqrt(0.5 * chi2_above(0.01, 2))
"""Radius of the 99 % region of a complex value in units of its standard deviation, E|e|^2 = std^2."""
MICRO = 1e6
MEASURED_NAME, MODEL_NAME, UNSEEN_NAME = "measured", "model", "unseen sweep"


def phase_deg(value: Complex) -> Real:
    """Phase without jumps, degrees, that begins in (-360, 0].

    >>> phase_deg(np.array([1j, -1 + 0.1j, -1 - 0.1j])).round().tolist()
    [-270.0, -186.0, -174.0]
    """
    angle = np.degrees(np.unwrap(np.angle(value)))
    turns = math.ceil(angle[0] / 360.0 - 1e-9) if len(angle) else 0
    return np.asarray(angle - 360.0 * turns)


def phase_beside(value: Complex, x: Real, curve_x: Real, curve_deg: Real) -> Real:
    """Phase of measured values on the same turn as a curve, degrees."""
    at = np.interp(np.log(x), np.log(curve_x), curve_deg)
    return np.asarray(at + np.degrees(np.angle(value * np.exp(-1j * np.radians(at)))))


def _band_of(plane: PlaneResult) -> tuple[float, float]:
    """Lowest and highest measured frequency of the plant, Hz."""
    hz = plane.curves.measured.frequency_hz
    return float(hz[0]), float(hz[-1])


def amplifier_figure(plane: PlaneResult, sample_time_s: float, computing_delay_s: float) -> Figure | None:
    """Measured i/u of both amplifiers with the first-order model and the chosen one; None where i is not logged."""
    scatter = plane.curves.amplifier_points
    if scatter is None:
        return None
    fig = Figure(
        f"amplifier-{plane.plane}", 3, 2, 620, weights=(1.25, 1.0, 1.0), titles=[f"amplifier {a}" for a in plane.axes]
    )
    delay = plane.model.delay_s + computing_delay_s
    for c, (axis, (omega, ratio, std)) in enumerate(zip("AB", scatter, strict=True)):
        hz = omega / (2 * np.pi)
        grid = np.geomspace(hz[0], hz[-1], 240)
        found = plane.amplifiers[axis]
        models = []
        if found.first_order is not None and found.order > 1:
            low, low_delay = found.first_order
            models.append(("first order", SECOND, "dash", np.array(low), low_delay))
        chosen = np.array([p.value for p in found.parameters.values()])
        name = {1: "first order", 2: "second order", 3: "third order"}[found.order]
        models.append((f"{name}, chosen", MODEL, "solid", chosen, delay))
        curve = phase_deg(amplifier.sampled(2 * np.pi * grid, chosen, delay, sample_time_s)[0])
        magnitudes = [np.abs(ratio)]
        fig.add(0, c, points(hz, np.abs(ratio), MEASURED_NAME))
        fig.add(1, c, points(hz, phase_beside(ratio, hz, grid, curve), MEASURED_NAME))
        for label, colour, dash, parameters, tau in models:
            response = amplifier.sampled(2 * np.pi * grid, parameters, tau, sample_time_s)[0]
            there = amplifier.sampled(omega, parameters, tau, sample_time_s)[0]
            fig.add(0, c, line(grid, np.abs(response), label, colour, dash=dash))
            fig.add(1, c, line(grid, phase_beside(response, grid, grid, curve), label, colour, dash=dash))
            fig.add(2, c, points(hz, 100 * np.abs(ratio / there - 1), label, colour, size=3.5))
            magnitudes.append(np.abs(response))
        noise = 100 * RADIUS_99 * std / np.abs(ratio)
        fig.add(2, c, line(hz, noise, "99 % of the noise", FOURTH, width=1.2))
        fig.y(0, c, **log_magnitude(magnitudes))
        fig.y(2, c, **log_magnitude([noise, *(t["y"] for t in fig.data if t.get("yaxis") == fig_axis(fig, 2, c))]))
        for r in range(3):
            fig.frequency(r, c, float(hz[0]), float(hz[-1]), title=r == 2)
        fig.share_x(c)
    fig.y(0, 0, title="|i/u|, A/A")
    fig.y(1, 0, title="phase, deg")
    fig.y(2, 0, title="difference, %")
    return fig


def fig_axis(fig: Figure, row: int, column: int) -> str:
    """Plotly's name of a panel's y axis in a trace."""
    return f"y{fig.number(row, column) or ''}"


def plant_figure(plane: PlaneResult, output: int) -> Figure:
    """u to one displacement: measured points, model with its 99 % region, and how far they are apart.

    The rows are magnitude, phase, and |measured - model| over |model|; the columns the two inputs.
    """
    c = plane.curves
    low, high = _band_of(plane)
    a, b = plane.axes
    titles = [f"u<sub>{axis}</sub> to y<sub>{plane.axes[output]}</sub>" for axis in (a, b)]
    fig = Figure(f"plant-{plane.plane}{'AB'[output]}", 3, 2, 680, weights=(1.5, 1.0, 1.15), titles=titles)
    hz, grid = c.measured.frequency_hz, c.omega / (2 * np.pi)
    shown = (grid >= low * 0.95) & (grid <= high * 1.05)
    grid = grid[shown]
    magnitudes: list[Real] = []
    differences: list[Real] = []
    for k in range(2):
        measured, model = c.measured.value[:, output, k], c.model[shown, output, k]
        there = c.model_at_lines[:, output, k]
        curve, size = phase_deg(model), np.abs(model)
        radius = RADIUS_99 * c.model_std[shown, output, k]
        fig.add(
            0, k, band(grid, MICRO * np.maximum(size - radius, 0.02 * size), MICRO * (size + radius), "99 % region")
        )
        fig.add(0, k, points(hz, MICRO * np.abs(measured), MEASURED_NAME))
        fig.add(0, k, line(grid, MICRO * size, MODEL_NAME))
        turn = np.degrees(np.arcsin(np.minimum(radius / size, 1.0)))
        fig.add(1, k, band(grid, curve - turn, curve + turn, "99 % region"))
        fig.add(1, k, points(hz, phase_beside(measured, hz, grid, curve), MEASURED_NAME))
        fig.add(1, k, line(grid, curve, MODEL_NAME))
        off = 100 * np.abs(measured - there) / np.abs(there)
        noise = 100 * c.measured.radius()[:, output, k] / np.abs(there)
        fig.add(2, k, band(grid, np.full(len(grid), 1e-9), 100 * radius / size, "99 % region"))
        fig.add(2, k, points(hz, off, MEASURED_NAME))
        fig.add(2, k, line(hz, noise, "99 % of the noise", FOURTH, width=1.2))
        magnitudes += [MICRO * size, MICRO * np.abs(measured)]
        differences += [off, noise]
        if c.validation is not None and c.validation_model is not None:
            v, unseen, predicted = c.validation.frequency_hz, c.validation.value[:, output, k], c.validation_model
            style = {"symbol": "diamond-open", "size": 6, "stroke": 1.2}
            fig.add(0, k, points(v, MICRO * np.abs(unseen), UNSEEN_NAME, SECOND, **style))
            fig.add(1, k, points(v, phase_beside(unseen, v, grid, curve), UNSEEN_NAME, SECOND, **style))
            gap = 100 * np.abs(unseen - predicted[:, output, k]) / np.abs(predicted[:, output, k])
            fig.add(2, k, points(v, gap, UNSEEN_NAME, SECOND, **style))
            differences.append(gap)
    for k in range(2):
        fig.y(0, k, **log_magnitude(magnitudes))
        fig.y(2, k, **log_magnitude(differences, floor=1e-4))
        for r in range(3):
            fig.frequency(r, k, low, high, title=r == 2)
        fig.share_x(k)
    fig.y(0, 0, title="magnitude, µm/A")
    fig.y(1, 0, title="phase, deg")
    fig.y(2, 0, title="difference, %")
    return fig


def inside_99_percent(plane: PlaneResult) -> float:
    """Share of the measured entries whose distance from the model is within the 99 % radius of their noise, percent."""
    c = plane.curves
    return 100.0 * float(np.mean(np.abs(c.measured.value - c.model_at_lines) <= c.measured.radius()))


def staged_figure(plane: PlaneResult) -> Figure:
    """The thesis's steps: rigid rotor below the split, flexible modes above, both stacked; from coil current."""
    c = plane.curves
    low, high = _band_of(plane)
    titles = [f"i<sub>{b}</sub> to y<sub>{a}</sub>" for a in plane.axes for b in plane.axes]
    fig = Figure(f"staged-{plane.plane}", 2, 2, 640, titles=titles)
    grid = c.omega / (2 * np.pi)
    shown = (grid >= low * 0.95) & (grid <= high * 1.05)
    grid = grid[shown]
    flexible = c.staged_plant - c.rigid_plant
    for a in range(2):
        for b in range(2):
            measured = MICRO * np.abs(c.plant.value[:, a, b])
            fig.add(a, b, points(c.plant.frequency_hz, measured, MEASURED_NAME))
            fig.add(a, b, line(grid, MICRO * np.abs(c.rigid_plant[shown, a, b]), "rigid rotor", SECOND, dash="dash"))
            if np.any(flexible):
                curve = MICRO * np.abs(flexible[shown, a, b])
                fig.add(a, b, line(grid, curve, "flexible modes", THIRD, dash="dot"))
            fig.add(a, b, line(grid, MICRO * np.abs(c.staged_plant[shown, a, b]), "both stacked", MODEL, width=1.3))
            fig.y(a, b, **log_magnitude([measured * 0.5, measured * 1.2]))
            fig.frequency(a, b, low, high, title=a == 1)
            fig.line_at(a, b, x=plane.staged.split_hz, text="split" if (a, b) == (0, 0) else "", colour=FOURTH)
        fig.y(a, 0, title="magnitude, µm/A")
    return fig


def sensitivity_figure(plane: PlaneResult, experiment: Experiment, datasheet: Datasheet) -> Figure:
    """|S| of both axes, measured as U over R and from the model, with the zones of ISO 14839-3."""
    omega = plane.curves.omega
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    model = sensitivity(plane.model, controller, omega)
    measured = _measured_sensitivity(plane, experiment)
    low, high = _band_of(plane)
    fig = Figure(f"sensitivity-{plane.plane}", 1, 2, 380, titles=[f"loop {a}" for a in plane.axes])
    grid = omega / (2 * np.pi)
    shown = (grid >= low * 0.95) & (grid <= high * 1.05)
    for k in range(2):
        if measured is not None:
            value = 20 * np.log10(np.abs(measured.value[:, k, k]))
            fig.add(0, k, points(measured.frequency_hz, value, MEASURED_NAME))
        fig.add(0, k, line(grid[shown], 20 * np.log10(np.abs(model[shown, k, k])), MODEL_NAME))
        fig.frequency(0, k, low, high)
        peak = 20 * math.log10(float(np.abs(model[:, k, k]).max()))
        fig.y(0, k, range=[-20, max(17.0, peak + 2.0)], dtick=5)
        for zone, limit in plane.zones_db[:-1]:
            fig.line_at(0, k, y=limit, text=f"zone {zone}", colour=SECOND, below=True)
    fig.y(0, 0, title="|S|, dB")
    return fig


def _measured_sensitivity(plane: PlaneResult, experiment: Experiment) -> FrequencyResponse | None:
    try:
        main = chosen_sweeps(experiment).main.sweep
        return etfe(plane_points(main, experiment.axes, plane.plane), "r->u")
    except AmbError:
        return None


__all__ = [
    "MEASURED",
    "REGION",
    "amplifier_figure",
    "inside_99_percent",
    "plant_figure",
    "sensitivity_figure",
    "staged_figure",
]
