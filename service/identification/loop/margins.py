"""Margins of the running loop: sensitivity measured directly, S = U R^-1, and from the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import closed_loop_poles
from service.identification.loop.loop_margins import CLOSE, REST, loop_margins, margins_of_loops, moved
from service.identification.measured.etfe import FrequencyResponse, SingularInputError, etfe
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel
from service.identification.plane.zoh import discrete_response
from service.identification.statistics.derivatives import central_differences, propagated_std
from sim.datasheet import ISO_14839_3_DB
from sim.errors import OptionsError

SURE = 5.0
"""Standard deviations by which a measured |S| must be above the model's peak to count as the larger one: it is the
largest of a hundred lines, and its deviation is an estimate from a few blocks."""
GAIN_LEFT = 0.5
"""Gain of the loop above the highest measured line from which margins hang on what is there. Further modes that a band
up to 1 kHz cuts off bring it to several times that, where none is cut off it is below a half of it."""
PER_DECADE = 144
"""Lines per decade where nothing rings."""
RINGS = 0.1
"""Damping ratio of a loop's pole below which lines are set about it."""
PLACED = 1e-8
"""Relative error of a peak's frequency. Its height needs far less, the height's derivatives do not: at a sharp mode
they change by several percent over a hundred-thousandth of the frequency."""


@dataclass(frozen=True)
class Margin:
    """One margin of the model's loop with its standard deviation; None where no such change meets the limit."""

    value: float | None
    std: float | None
    measured: float | None
    """The same of the measured sensitivity, straight between the experiment's lines: one that a sharp mode between two
    lines makes smaller is not seen."""


@dataclass(frozen=True)
class AxisMargins:
    """Margins of one axis with the other loops closed."""

    sensitivity_peak: float
    """max |S|, from the model."""
    peak_hz: float
    peak_std: float
    measured_peak: float | None
    """Largest measured |S|: at the lines of the experiment only, so at most the true peak but for its noise."""
    measured_peak_hz: float | None
    measured_std: float | None
    measured_above: float | None
    """The largest measured |S| that is above the model's peak beyond doubt; None where none is."""
    gain_down_db: Margin
    """How far the gain may fall, and rise, dB."""
    gain_up_db: Margin
    phase_deg: Margin
    delay_s: Margin

    @property
    def worst(self) -> float:
        """The peak that a zone goes by."""
        return self.sensitivity_peak if self.measured_above is None else self.measured_above


def margins_document(margins: dict[str, AxisMargins]) -> dict[str, Any]:
    """As JSON: every figure by axis, gain margins as [down, up]."""
    axes = margins.items()

    def every(told: Callable[[Margin], float | None]) -> dict[str, Any]:
        return {
            "gain_margin_db": {a: [told(m.gain_down_db), told(m.gain_up_db)] for a, m in axes},
            "phase_margin_deg": {a: told(m.phase_deg) for a, m in axes},
            "delay_margin_s": {a: told(m.delay_s) for a, m in axes},
        }

    return {
        "sensitivity_peak": {a: m.sensitivity_peak for a, m in axes},
        "sensitivity_peak_std": {a: m.peak_std for a, m in axes},
        "sensitivity_peak_hz": {a: m.peak_hz for a, m in axes},
        "measured_sensitivity_peak": {a: m.measured_peak for a, m in axes},
        "measured_sensitivity_peak_hz": {a: m.measured_peak_hz for a, m in axes},
        "measured_sensitivity_peak_std": {a: m.measured_std for a, m in axes},
        **every(lambda m: m.value),
        **{f"{name}_std": v for name, v in every(lambda m: m.std).items()},
        **{f"measured_{name}": v for name, v in every(lambda m: m.measured).items()},
    }


def zone(peak: float, limits: tuple[tuple[str, float], ...] = ISO_14839_3_DB) -> str:
    """Zone, by default of ISO 14839-3, for a peak sensitivity (not in dB).

    >>> [zone(x) for x in (2.9, 3.5, 4.9, 5.1)]
    ['A', 'B', 'C', 'D']
    """
    decibel = 20 * math.log10(max(peak, 1e-12))
    return next(name for name, limit in limits if decibel < limit or math.isinf(limit))


def zone_table(text: str) -> tuple[tuple[str, float], ...]:
    """Zones and their upper limits in dB from a user's words; the last zone has no limit.

    Raises
    ------
    OptionsError
        Not of that form, limits that do not rise, or no last zone without a limit.

    >>> zone_table("good=9.5, bad")
    (('good', 9.5), ('bad', inf))
    """
    found: list[tuple[str, float]] = []
    try:
        for part in text.split(","):
            name, _, limit = part.strip().partition("=")
            found.append((name.strip(), float(limit) if limit.strip() else math.inf))
    except ValueError as error:
        raise OptionsError(f"zones {text!r} cannot be read; write them as A=9.5,B=12,C=14,D") from error
    limits = [limit for _, limit in found]
    names = [name for name, _ in found]
    rising = all(a < b for a, b in pairwise(limits))
    if not rising or not math.isinf(limits[-1]) or not all(names) or len(set(names)) < len(names):
        raise OptionsError(f"zones {text!r} need different names, rising limits in dB, and a last zone without a limit")
    return tuple(found)


def computed_response(model: PlaneModel, omega: Real) -> Complex:
    """Small-signal response from u as the controller computes it to sampled y, (P, 2, 2)."""
    response, chain = model.response(omega), model.known.chain
    return np.asarray(response @ chain.crosstalk) if chain.has_crosstalk else response


def sensitivity(model: PlaneModel, controller: tuple[Real, Real], omega: Real) -> Complex:
    """S = (I + G C)^-1 at the plant's input, u = S r, from the sampled model, (P, 2, 2)."""
    c = discrete_response(*controller, omega, model.known.sample_time_s)
    loop = computed_response(model, omega) * c[:, None, None]
    loop[:, 0, 0] += 1.0
    loop[:, 1, 1] += 1.0
    return np.asarray(np.linalg.inv(loop), dtype=np.complex128)


def axis_loops(sensitivities: Complex) -> Complex:
    """The loop of each axis, the others closed, from S, (P, n, n): L = 1/S_jj - 1, (P, n)."""
    return np.asarray(1.0 / np.diagonal(sensitivities, axis1=1, axis2=2) - 1.0)


def loop_grid(model: PlaneModel, poles: Complex) -> Real:
    """Frequencies up to almost half the sample rate that show every peak of a plane and of a loop that it is in, rad/s.

    From rest on, where a loop without an integrator has its lower gain margin.

    Parameters
    ----------
    poles
        Eigenvalues of the sampled loop: a strong law moves a lightly damped mode far from where the plant has it.
    """
    period = model.known.sample_time_s
    highest = 2 * np.pi * 0.49 / period
    slow, base = _per_decade(REST, 2 * np.pi, 60)[:-1], _per_decade(2 * np.pi, highest, PER_DECADE)
    near = [m[0] * (1 + np.linspace(-0.02, 0.02, 41)) for m in model.modes if 0 < m[0] < highest]
    grid = np.unique(np.concatenate([slow, base, *near, *_about(poles, period)]))
    return np.asarray(grid[grid <= highest])


def dense_grid(model: PlaneModel, poles: Complex) -> Real:
    """The same from 1 Hz on."""
    grid = loop_grid(model, poles)
    return np.asarray(grid[grid >= 2 * np.pi])


def _about(poles: Complex, period_s: float) -> list[Real]:
    """Frequencies about each pole of a sampled loop that rings, rad/s: as close to each other as the loop turns there.

    A quarter of the pole's half-width apart at the pole, a quarter of their distance to it farther away, up to where
    the other lines are no farther apart.
    """
    s = np.log(poles[poles.imag > 0]) / period_s
    w, zeta = np.abs(s), np.maximum(np.abs(s.real) / np.abs(s), CLOSE)
    reach = np.arcsinh(math.log(10) / PER_DECADE / zeta)
    return [
        a * (1 + b * np.sinh(np.linspace(-r, r, 1 + 2 * math.ceil(4 * r))))
        for a, b, r in zip(w, zeta, reach, strict=True)
        if b < RINGS
    ]


def _per_decade(lowest: float, highest: float, number: int) -> Real:
    return np.geomspace(lowest, highest, 1 + math.ceil(number * math.log10(highest / lowest)))


@dataclass(frozen=True)
class Peak:
    """The largest |S_jj| of an axis, the other loop closed."""

    value: float
    omega: float
    """rad/s"""


def sensitivity_peaks(model: PlaneModel, controller: tuple[Real, Real]) -> tuple[Peak, Peak]:
    """Peaks of both axes: the largest of a dense grid, then the maximum between its neighbours.

    Parameters
    ----------
    controller
        Numerator and denominator of the discrete law from -y to u.
    """
    omega = loop_grid(model, closed_loop_poles(model, controller))
    size = np.abs(sensitivity(model, controller, omega))
    return _refined(model, controller, omega, size[:, 0, 0], 0), _refined(model, controller, omega, size[:, 1, 1], 1)


def heights(model: PlaneModel, controller: tuple[Real, Real], peaks: tuple[Peak, Peak]) -> Real:
    """|S_jj| of both axes where a neighbouring model has its peaks, (2,).

    To first order the height of a peak does not depend on its place (the envelope theorem): for its derivatives to the
    parameters it need not be found anew with each of them.
    """
    s = sensitivity(model, controller, np.array([peak.omega for peak in peaks]))
    return np.abs(s[[0, 1], [0, 1], [0, 1]])


def _refined(model: PlaneModel, controller: tuple[Real, Real], omega: Real, size: Real, j: int) -> Peak:
    k = int(np.argmax(size))
    low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]

    def below(w: float) -> float:
        return -float(np.abs(sensitivity(model, controller, np.array([w]))[0, j, j]))

    found = minimize_scalar(below, bounds=(low, high), method="bounded", options={"xatol": PLACED * omega[k]})
    if -found.fun > size[k]:
        return Peak(-float(found.fun), float(found.x))
    return Peak(float(size[k]), float(omega[k]))


@dataclass(frozen=True)
class Beyond:
    """What of a loop lies above the highest measured line, in words; "" where nothing does.

    There a model is a guess: it has one mode for all that lie beyond the band, known by what they leave within it.
    """

    peak: str = ""
    """That a sensitivity peak does, so that it is not known, nor its zone."""
    gain: str = ""
    """That the loop's gain is not small there. Of a loop that was measured the peaks within the band are known all the
    same; one that has never run may be unstable there."""

    @property
    def either(self) -> str:
        """Why nothing is known of a controller that has never run."""
        return self.peak or self.gain


def beyond_measured(model: PlaneModel, controller: tuple[Real, Real], axes: Sequence[str], highest_hz: float) -> Beyond:
    """What of a plane's loop lies above the highest measured line: `beyond_lines` of the model."""
    omega = loop_grid(model, closed_loop_poles(model, controller))
    return beyond_lines(omega, sensitivity(model, controller, omega), axes, highest_hz)


def beyond_lines(omega: Real, s: Complex, axes: Sequence[str], highest_hz: float) -> Beyond:
    """The same from the sensitivity at frequencies that show every peak of it, (P, n, n) of n axes."""
    peaks = omega[np.abs(np.diagonal(s, axis1=1, axis2=2)).argmax(axis=0)] / (2 * np.pi)
    beyond = omega > 2 * np.pi * highest_hz
    if not np.any(beyond):
        return Beyond()
    where = f"above the highest measured line ({highest_hz:.4g} Hz), where the model is a guess; measure farther up"
    high = [f"that of {axis} at {hz:.4g} Hz" for axis, hz in zip(axes, peaks, strict=True) if hz > highest_hz]
    gain = np.linalg.norm(np.linalg.inv(s[beyond]) - np.eye(len(axes)), ord=2, axis=(1, 2))
    k = int(np.argmax(gain))
    return Beyond(
        f"a sensitivity peak, {' and '.join(high)}, lies {where}" if high else "",
        f"the loop's gain is {gain[k]:.2g} at {omega[beyond][k] / (2 * np.pi):.4g} Hz, {where}"
        if gain[k] > GAIN_LEFT
        else "",
    )


def measured_sensitivity(points: PlanePoints) -> FrequencyResponse | None:
    """S = U R^-1 of a plane, without points that had not settled; None where the others do not tell it.

    Parameters
    ----------
    points
        With u as the controller computed it.
    """
    try:
        return etfe(points.select(~points.suspect) if points.suspect.any() else points, "r->u")
    except SingularInputError:  # two axes excited at once, with the same r: S cannot be told apart
        return None


def above(measured: FrequencyResponse, j: int, peak: float) -> float | None:
    """The largest measured |S_jj| that is larger than a peak of the model beyond doubt; None where none is."""
    size, std = np.abs(measured.value[:, j, j]), measured.std[:, j, j] / math.sqrt(2)
    sure = size[size - SURE * std > peak]
    return float(sure.max()) if len(sure) else None


def axis_margins(
    model: PlaneModel,
    controller: tuple[Real, Real],
    covariance: Real,
    free: np.ndarray,
    measured: FrequencyResponse | None,
) -> tuple[AxisMargins, AxisMargins]:
    """Margins of both axes of a plane.

    Parameters
    ----------
    covariance, free
        Of the fitted parameters, and which they are.
    measured
        ETFE r->u of the plane.
    """
    omega = loop_grid(model, closed_loop_poles(model, controller))
    s = sensitivity(model, controller, omega)
    out = []
    loops = margins_of_loops(omega, axis_loops(s), lambda w: axis_loops(sensitivity(model, controller, w)))
    for j, loop in enumerate(loops):
        peak = _refined(model, controller, omega, np.abs(s[:, j, j]), j)
        peak_std, *stds = _stds(model, controller, peak.omega, loop.places(), j, covariance, free)
        seen = seen_hz = seen_std = more = None
        measured_loop: tuple[float | None, ...] = (None, None, None, None)
        if measured is not None:
            own = measured.value[:, j, j]
            m = int(np.argmax(np.abs(own)))
            seen, seen_hz = float(np.abs(own[m])), float(measured.frequency_hz[m])
            seen_std = float(measured.std[m, j, j] / math.sqrt(2))
            more = above(measured, j, peak.value)
            measured_loop = loop_margins(measured.omega, 1.0 / own - 1.0).values()
        hz = peak.omega / (2 * np.pi)
        margins = (
            Margin(value, None if value is None else std, direct)
            for value, std, direct in zip(loop.values(), stds, measured_loop, strict=True)
        )
        out.append(AxisMargins(peak.value, hz, peak_std, seen, seen_hz, seen_std, more, *margins))
    return out[0], out[1]


def _stds(
    model: PlaneModel,
    controller: tuple[Real, Real],
    peak: float,
    places: Real,
    j: int,
    covariance: Real,
    free: np.ndarray,
) -> list[float]:
    """Standard deviations of |S_jj| at its peak, whose place does not matter to first order, and of four margins."""
    every = np.append(places.ravel(), peak)
    known = np.isfinite(every)

    def of(theta: Real) -> Real:
        s = sensitivity(model.at(theta), controller, every[known])[:, j, j]
        loops: Complex = np.full(places.size, np.nan, dtype=np.complex128)
        loops[known[:-1]] = 1.0 / s[:-1] - 1.0
        return np.append(np.abs(s[-1]), moved(places, loops.reshape(places.shape)))

    std = np.sqrt(np.maximum(np.diag(covariance), 0))
    # longer ones of a sharp mode's frequency leave the part of its resonance that is straight
    steps = np.minimum(0.1 * std, 1e-5 * np.abs(model.theta[free]))
    gradient = central_differences(of, model.theta, free, np.where(steps == 0, 1e-12, steps))
    return [float(v) for v in propagated_std(gradient, covariance)]
