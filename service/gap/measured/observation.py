"""A sweep made ready for fitting: mean amplitudes, and the standard deviation of what a model leaves of them.

The control signal is computed by the controller and so known exactly; noise sits in i and y. What a model must
explain is e = X - model(U), and the scatter of exactly that quantity over the blocks is its noise: the part of
the noise that feedback carries round cancels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.coherent import PATTERNS, beside_hum, left_in_mean, slow_leaks, without_hum
from service.gap.measured.excited_together import Together
from service.gap.measured.leak import leaked, periods
from service.gap.measured.scatter import mean_scatter
from service.gap.measured.settling import drifting, trend
from service.gap.measured.wander import wander
from sim.errors import AmbError
from sim.harmonic_balance import time_points
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

MODEL_FLOOR = 3e-4
"""Relative error below which no twin is trusted: integrators, hold details and rounding of two programs for the
same rig differ by this much near 1 kHz (measured on rigs of an independent program)."""


CONTROLLER_FLOOR = 3e-5
"""The same for the controller: its law is arithmetic, with nothing to integrate between samples, so only the digits to
which a datasheet writes its coefficients count."""


UNSETTLED_SHARE = 0.25
"""Share of a point's drift, first block to last, that is counted as its error: a block of a signal that still
decays obeys Y = G U only up to what the state changes from end to end (0.17 of the drift measured near a mode)."""


DRIFT_P_VALUE = 1e-4
"""Probability by chance below which a channel's trend from block to block counts as a drift."""


ENDS = 2.0
"""What a drift over a point's k periods leaves of a law without a resonance, the controller's or an amplifier's, times
pi k (0.7 to 1.7 times the drift on rigs of an independent program, at any harmonic of the controller's)."""


SMALLEST_SHARE = 1e-6
"""Smallest standard deviation, as a share of the largest amplitude of a signal: finer than any converter."""
RINGING = 0.04
"""Relative distance to a flexible mode within which it still rings in the blocks, from the last change of frequency or
from noise: there blocks are not independent, so their mean is no better than one, and no harmonic is judged."""
HARMONIC_ERROR = 0.1
"""Relative error of a harmonic below which no law is trusted: two laws of one effect differ by this much."""


HUMMED = 0.35
"""Relative distance to an interference within which it is counted as a point's own error."""


class GapError(AmbError):
    """The data do not allow a diagnosis; the message says what is missing."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One sweep. P points, H harmonics, n axes; standard deviations are of the complex mean, E|e|^2 = sd^2."""

    frequency_hz: Real
    """(F,) distinct"""
    line: NDArray[np.int64]
    """(P,) index into ``frequency_hz``"""
    axis: NDArray[np.int64]
    """(P,)"""
    harmonics: tuple[int, ...]
    R: Complex
    U: Complex
    I: Complex | None
    Y: Complex
    sd_u: Real
    """(P, H, n)"""
    sd_i: Real
    sd_y: Real
    progress: Real
    """(P,) when each was measured, 0 to 1 over the sweeps looked at"""
    drifting: NDArray[np.bool_]
    """(P,) which points had not settled"""
    drift: Real
    """(P,) change along the trend of a point's blocks, relative to its size"""
    speed_rad_s: float
    together: Together | None = None
    """Of a multisine, whose lines excite the rotor at once; None for one tone after the other."""

    @property
    def points_hz(self) -> Real:
        """Excited frequency of each point, (P,)."""
        return self.frequency_hz[self.line]

    @property
    def unsettled(self) -> float:
        """Share of points that still drift from their first block to their last."""
        return float(self.drifting.mean())

    @property
    def fundamental(self) -> int:
        """Index of harmonic 1."""
        return self.harmonics.index(1)

    def select(self, lines: NDArray[np.bool_]) -> Observation:
        """Some of the lines, (F,), each with the noise that all of them together told of."""
        at = lines[self.line]
        per_point = {f.name: getattr(self, f.name) for f in fields(self)}
        per_point.pop("frequency_hz")
        chosen: dict[str, Any] = {name: v[at] for name, v in per_point.items() if isinstance(v, np.ndarray)}
        chosen["line"] = (np.cumsum(lines) - 1)[self.line[at]]
        return replace(self, frequency_hz=self.frequency_hz[lines], **chosen)


def usable(sweep: Sweep) -> Sweep:
    """The excited, finite points of a sweep.

    Raises
    ------
    GapError
        Nothing is left, or the blocks are too few to tell noise from signal.
    """
    arrays = [sweep.R, sweep.U, sweep.Y] + ([] if sweep.I is None else [sweep.I])
    good = (sweep.amplitude_a > 0) & np.all([np.isfinite(a).all(axis=(1, 2, 3)) for a in arrays], axis=0)
    if sweep.Y.shape[1] < 2:
        raise GapError(f"sweep {sweep.comment!r} has {sweep.Y.shape[1]} block; record at least 2 blocks a point")
    if good.sum() < 8:
        raise GapError(f"sweep {sweep.comment!r} has {good.sum()} usable points; a diagnosis needs at least 8")
    return sweep.select(good)


def observe(
    sweep: Sweep,
    rig: Rig,
    progress: tuple[float, float] = (0.0, 1.0),
    hums_hz: Sequence[float] = (),
    span_s: tuple[float, float] | None = None,
    together: Together | None = None,
) -> Observation:
    """Prepare a sweep.

    Parameters
    ----------
    rig
        Any reasonable twin: it only serves to take the feedback out of the block scatter.
    progress
        Of the first point and of the last, which are taken to be measured in order and at even intervals...
    span_s
        ... unless this gives the times, s, of progress 0 and 1, and the sweep those of its points.
    hums_hz
        Frequencies of interference, the loudest first; it leaves something in the mean over a point's blocks.
    together
        All lines of the multisine that the sweep is part of.
    """
    sweep = usable(sweep)
    frequency, line = time_points(sweep.frequency_hz)
    U, Y, blocks = sweep.U, sweep.Y, sweep.Y.shape[1]
    heard, by = sweep, None
    if hums_hz and sweep.block_samples is not None and blocks > PATTERNS:
        by = beside_hum(sweep, hums_hz[0])
        sweep = without_hum(sweep, hums_hz[0])
        U, Y = sweep.U, sweep.Y
    leaks = None
    if hums_hz and heard.block_samples is not None:
        leaks = slow_leaks(heard, heard.U, hums_hz), slow_leaks(heard, heard.Y, hums_hz)
    sds = tuple(np.sqrt(v) for v in mean_scatter(sweep, rig, by))
    sd_u, sd_i, sd_y = _with_hum(sds, heard, rig, hums_hz) if hums_hz else sds
    f = sweep.harmonics.index(1)
    mean_u, mean_y = U.mean(axis=1), Y.mean(axis=1)
    mean_i = None if sweep.I is None else sweep.I.mean(axis=1)
    sd_u = _with_floor(sd_u, mean_u, sweep.harmonics, CONTROLLER_FLOOR)
    sd_y = _with_floor(sd_y, mean_y, sweep.harmonics)
    sd_i = sd_i if mean_i is None else _with_floor(sd_i, mean_i, sweep.harmonics)
    drift_y, drift_u = _drift(Y[:, :, f], sd_y[:, f], blocks), _trend(U[:, :, f])
    sd_y = np.hypot(sd_y, UNSETTLED_SHARE * drift_y[:, None, None])
    sd_u = np.hypot(sd_u, _of_ends(sweep, drift_u)[:, None, None])
    if sweep.I is not None:  # at the excited frequency an amplifier answers to a slow change as to a steady tone
        elsewhere = np.arange(len(sweep.harmonics)) != f
        drift_i = _trend(sweep.I[:, :, f])
        sd_i[:, elsewhere] = np.hypot(sd_i[:, elsewhere], _of_ends(sweep, drift_i)[:, None, None])
    rings = ringing(rig, sweep)
    sd_y[:, f][rings[:, f]] *= np.sqrt(blocks)
    rings[:, f] = False
    sd_y[rings] = np.inf
    if 0 in sweep.harmonics:
        k = sweep.harmonics.index(0)
        sd_u, sd_i, sd_y = _with_leak((sd_u, sd_i, sd_y), sweep, rig, k)
        means = (mean_u, mean_u if mean_i is None else mean_i, mean_y)
        sd_y[:, k] = np.hypot(sd_y[:, k], wander(rig, means, sd_y[:, k], k, f, sweep))
    restless, change = drifting(sweep, leaks)
    return Observation(
        frequency_hz=frequency,
        line=line,
        axis=sweep.axis,
        harmonics=sweep.harmonics,
        R=sweep.R.mean(axis=1),
        U=mean_u,
        I=mean_i,
        Y=mean_y,
        sd_u=sd_u,
        sd_i=sd_i,
        sd_y=sd_y,
        progress=_progress(sweep, progress, span_s),
        drifting=restless,
        drift=change,
        speed_rad_s=sweep.speed_rad_s,
        together=together,
    )


def _with_floor(sd: Real, mean: Complex, harmonics: tuple[int, ...], floor: float = MODEL_FLOOR) -> Real:
    """Standard deviation with the model's own error, relative to the size of each channel and harmonic."""
    relative = np.where(np.array(harmonics) > 1, HARMONIC_ERROR, 0.0)  # a mean holds the static position too
    relative[harmonics.index(1)] = floor
    smallest = SMALLEST_SHARE * np.abs(mean).max()  # a coarse converter may not scatter at all
    return np.asarray(np.maximum(np.hypot(sd, relative[:, None] * np.abs(mean)), smallest))


def _progress(sweep: Sweep, even: tuple[float, float], span_s: tuple[float, float] | None) -> Real:
    if span_s is None or sweep.time_s is None:
        return np.linspace(*even, sweep.n_points)
    return np.asarray((sweep.time_s - span_s[0]) / (span_s[1] - span_s[0]))


def _with_hum(sds: tuple[Real, ...], sweep: Sweep, rig: Rig, hums_hz: Sequence[float]) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with what hums leave in the means of both ends of each part of the loop."""
    if sweep.block_samples is None:  # as if the blocks were one
        one = np.where(near_hum(sweep, hums_hz)[..., None], np.sqrt(sweep.Y.shape[1]), 1.0)
        return tuple(sd * one for sd in sds)
    u, i, y = (left_in_mean(sweep, X, hums_hz) for X in (sweep.U, sweep.U if sweep.I is None else sweep.I, sweep.Y))
    of_u, of_i, of_y = (sd.copy() for sd in sds)
    frequency, line = time_points(sweep.frequency_hz)
    for k, h in enumerate(sweep.harmonics):
        model = linear_model(rig, np.maximum(h * frequency, 1e-2))

        def through(G: Complex, x: Real, k: int = k) -> Real:
            return np.asarray(np.sqrt(np.einsum("pij,pj->pi", np.abs(G[line]) ** 2, x[:, k] ** 2)))

        C = model.controller[:, None, None] * np.eye(rig.n_axes)
        of_u[:, k] = np.sqrt(of_u[:, k] ** 2 + u[:, k] ** 2 + through(C, y) ** 2)
        of_i[:, k] = np.sqrt(of_i[:, k] ** 2 + i[:, k] ** 2 + through(model.i_per_u, u) ** 2)
        of_y[:, k] = np.sqrt(of_y[:, k] ** 2 + y[:, k] ** 2 + through(model.y_per_u, u) ** 2)
    return of_u, of_i, of_y


def _with_leak(sds: tuple[Real, ...], sweep: Sweep, rig: Rig, at_rest: int) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with what the slow rest of a start leaks; ``at_rest``: index of harmonic 0."""
    of_u, of_i, of_y = (sd.copy() for sd in sds)
    frequency, line = time_points(sweep.frequency_hz)
    U, Y = sweep.U[:, :, at_rest], sweep.Y[:, :, at_rest]
    for k, h in enumerate(sweep.harmonics):
        if h == 0:
            continue
        model = linear_model(rig, h * frequency)
        C = -model.controller[line, None, None] * np.eye(rig.n_axes)
        of_u[:, k] = np.hypot(of_u[:, k], leaked(sweep, h, C, U - sweep.R[:, :, at_rest], Y))
        of_y[:, k] = np.hypot(of_y[:, k], leaked(sweep, h, model.y_per_u[line], Y, U))
        if sweep.I is not None:
            of_i[:, k] = np.hypot(of_i[:, k], leaked(sweep, h, model.i_per_u[line], sweep.I[:, :, at_rest], U))
    return of_u, of_i, of_y


def near_hum(sweep: Sweep, hums_hz: Sequence[float], width: float = HUMMED) -> NDArray[np.bool_]:
    """Harmonics of the points that lie near an interference, (P, H)."""
    at = (sweep.frequency_hz[:, None] * np.array(sweep.harmonics))[..., None]
    hums = np.array(hums_hz, dtype=float)
    return np.asarray(np.any(np.abs(at - hums) < width * hums, axis=-1))


def ringing(rig: Rig, sweep: Sweep) -> NDArray[np.bool_]:
    """Harmonics that fall on a flexible mode, (P, H)."""
    modes = np.array([mode.natural_frequency_rad_s for plane in rig.rotor.modes for mode in plane]) / (2 * np.pi)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    return np.asarray(np.any(np.abs(at[..., None] - modes) < RINGING * modes, axis=-1))


def _of_ends(sweep: Sweep, drift: Real) -> Real:
    """What a law without a resonance leaves of a signal that drifts so much over the blocks of a point, (P,)."""
    return np.asarray(drift * ENDS / (np.pi * periods(sweep) * sweep.Y.shape[1]))


def _drift(Y: Complex, sd: Real, blocks: int) -> Real:
    """Change of each point from its first block to its last beyond what noise allows, (P,), m."""
    change = np.abs(Y[:, -1] - Y[:, 0])
    return np.asarray(np.maximum(change - 4 * sd * np.sqrt(2 * blocks), 0.0).max(axis=1))


def _trend(X: Complex) -> Real:
    """Change of each point along the trend of its blocks, where noise has none like it, (P,), A.

    Held against the blocks' own scatter: the loop brings sensors' noise into u and i, and what the controller or an
    amplifier leaves of them has hardly any.
    """
    probability, change = trend(X)
    return np.asarray(np.where(probability < DRIFT_P_VALUE, change, 0.0).max(axis=1))
