"""A sweep prepared for fitting: mean amplitudes, and the standard deviations of a right model's residuals.

The control signal is computed by the controller and so known exactly; noise is in i and y. A model is fitted to e = X -
model(U), so the noise that counts is the scatter of e over the blocks: what the feedback loop makes of the noise is in
X and in U alike, and cancels. Errors that do not scatter (the model's own, leakage, drift, hum) are added to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.experiment.dead import dropped
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
"""Relative error of a twin that counts as noise: integrators, hold details and rounding of two programs for the same
rig differ by this much near 1 kHz (measured on rigs of an independent program)."""


CONTROLLER_FLOOR = 3e-5
"""The same for the controller: its law is arithmetic, with nothing to integrate between samples, so only the digits to
which a datasheet writes its coefficients count."""


UNSETTLED_SHARE = 0.25
"""Share of a point's drift, first block to last, that is added to its error: a block of a signal that still decays
obeys Y = G U only up to the change of the state from end to end (0.17 of the drift measured near a mode)."""


DRIFT_P_VALUE = 1e-4
"""Probability by chance below which a channel's trend from block to block counts as a drift."""


LEAKAGE_OF_DRIFT = 2.0
"""Residual of a law without a resonance (controller, amplifier) at a point that drifts, over drift / (pi k) of k
periods (0.7 to 1.7 on rigs of an independent program, at any harmonic of the controller's)."""


SMALLEST_SHARE = 1e-6
"""Smallest standard deviation, as a share of the largest amplitude of a signal: finer than any converter."""
RINGING = 0.04
"""Relative distance to a flexible mode within which it rings in the blocks, from the last change of frequency or from
noise. Blocks are not independent there, so their mean counts as one block, and other harmonics are not judged."""
HARMONIC_ERROR = 0.1
"""Relative error of a predicted harmonic that counts as noise: two programs' laws of one effect differ by this much."""


HUMMED = 0.35
"""Relative distance to an interference within which it adds to a point's error, where blocks have no known length."""


class GapError(AmbError):
    """The data do not allow a diagnosis; the message says what is missing."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """One sweep as it is fitted: P points, H harmonics, n axes.

    R, U, I and Y are mean complex amplitudes over the blocks, (P, H, n), A and m. Standard deviations are those of the
    complex residual, E|e|^2 = sd^2.
    """

    frequency_hz: Real
    """(F,) distinct"""
    line: NDArray[np.int64]
    """(P,) index into ``frequency_hz``"""
    axis: NDArray[np.int64]
    """(P,) index of the excited axis"""
    harmonics: tuple[int, ...]
    R: Complex
    U: Complex
    I: Complex | None
    Y: Complex
    sd_u: Real
    """(P, H, n) of u - (r - C y), A"""
    sd_i: Real
    """(P, H, n) of i - A u, A"""
    sd_y: Real
    """(P, H, n) of y - P A u, m"""
    progress: Real
    """(P,) when each was measured, 0 to 1 over the sweeps of the diagnosis"""
    drifting: NDArray[np.bool_]
    """(P,) which points had not settled"""
    drift: Real
    """(P,) change along the trend of a point's blocks, relative to its size"""
    speed_rad_s: float
    together: Together | None = None
    """All lines of a multisine, which excite the rotor at once; None of a stepped sine."""

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
        """Some of the lines, (F,); their standard deviations stay those estimated from all lines."""
        at = lines[self.line]
        per_point = {f.name: getattr(self, f.name) for f in fields(self)}
        per_point.pop("frequency_hz")
        chosen: dict[str, Any] = {name: v[at] for name, v in per_point.items() if isinstance(v, np.ndarray)}
        chosen["line"] = (np.cumsum(lines) - 1)[self.line[at]]
        return replace(self, frequency_hz=self.frequency_hz[lines], **chosen)


def usable(sweep: Sweep) -> Sweep:
    """The excited, finite points of a sweep at which the log was not interrupted.

    Raises
    ------
    GapError
        Nothing is left, or the blocks are too few to tell noise from signal.
    """
    arrays = [sweep.R, sweep.U, sweep.Y] + ([] if sweep.I is None else [sweep.I])
    finite = np.all([np.isfinite(a).all(axis=(1, 2, 3)) for a in arrays], axis=0)
    good = (sweep.amplitude_a > 0) & ~dropped(sweep) & finite
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
    """The observation of a sweep.

    Parameters
    ----------
    rig
        Any reasonable twin: it serves to take the feedback of noise out of the block scatter.
    progress
        Of the first point and of the last, which are taken to be measured in order and at even intervals...
    span_s
        ... unless this gives the times, s, of progress 0 and 1, and the sweep those of its points.
    hums_hz
        Frequencies of interference, the loudest first. The loudest is taken off the blocks where their length is
        known and they are enough; what hums leave in the means is added to the standard deviations.
    together
        All lines of the multisine that the sweep is part of.
    """
    sweep = usable(sweep)
    frequency, line = time_points(sweep.frequency_hz)
    with_hum, by = sweep, None
    if hums_hz and sweep.block_samples is not None and sweep.Y.shape[1] > PATTERNS:
        by = beside_hum(sweep, hums_hz[0])
        sweep = without_hum(sweep, hums_hz[0])
    hum_leaks = None
    if hums_hz and with_hum.block_samples is not None:
        hum_leaks = slow_leaks(with_hum, with_hum.U, hums_hz), slow_leaks(with_hum, with_hum.Y, hums_hz)
    sds = tuple(np.sqrt(v) for v in mean_scatter(sweep, rig, by))
    sds = _with_hum(sds, with_hum, rig, hums_hz) if hums_hz else sds
    sds = _with_drift(_with_model_error(sds, sweep), sweep)
    sds = _with_ringing(sds, sweep, rig)
    if 0 in sweep.harmonics:
        sds = _with_remanence(_with_transient_leakage(sds, sweep, rig), sweep, rig)
    sd_u, sd_i, sd_y = sds
    unsettled, change = drifting(sweep, hum_leaks)
    return Observation(
        frequency_hz=frequency,
        line=line,
        axis=sweep.axis,
        harmonics=sweep.harmonics,
        R=sweep.R.mean(axis=1),
        U=sweep.U.mean(axis=1),
        I=None if sweep.I is None else sweep.I.mean(axis=1),
        Y=sweep.Y.mean(axis=1),
        sd_u=sd_u,
        sd_i=sd_i,
        sd_y=sd_y,
        progress=_progress(sweep, progress, span_s),
        drifting=unsettled,
        drift=change,
        speed_rad_s=sweep.speed_rad_s,
        together=together,
    )


def _with_model_error(sds: tuple[Real, ...], sweep: Sweep) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with the errors of their models."""
    sd_u, sd_i, sd_y = sds
    sd_u = _with_floor(sd_u, sweep.U.mean(axis=1), sweep.harmonics, CONTROLLER_FLOOR)
    sd_y = _with_floor(sd_y, sweep.Y.mean(axis=1), sweep.harmonics)
    if sweep.I is not None:
        sd_i = _with_floor(sd_i, sweep.I.mean(axis=1), sweep.harmonics)
    return sd_u, sd_i, sd_y


def _with_drift(sds: tuple[Real, ...], sweep: Sweep) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with what a drift along the blocks leaves in them."""
    sd_u, sd_i, sd_y = sds
    f, blocks = sweep.harmonics.index(1), sweep.Y.shape[1]
    drift_y, drift_u = _drift(sweep.Y[:, :, f], sd_y[:, f], blocks), _trend(sweep.U[:, :, f])
    sd_y = np.hypot(sd_y, UNSETTLED_SHARE * drift_y[:, None, None])
    sd_u = np.hypot(sd_u, _drift_leakage(sweep, drift_u)[:, None, None])
    if sweep.I is not None:  # at the excited frequency an amplifier answers to a slow change as to a steady tone
        sd_i, elsewhere = sd_i.copy(), np.arange(len(sweep.harmonics)) != f
        drift_i = _trend(sweep.I[:, :, f])
        sd_i[:, elsewhere] = np.hypot(sd_i[:, elsewhere], _drift_leakage(sweep, drift_i)[:, None, None])
    return sd_u, sd_i, sd_y


def _with_ringing(sds: tuple[Real, ...], sweep: Sweep, rig: Rig) -> tuple[Real, ...]:
    """Standard deviations of u, i and y; near a flexible mode that of y is of one block, and infinite at harmonics."""
    sd_u, sd_i, sd_y = sds
    f, rings, sd_y = sweep.harmonics.index(1), ringing(rig, sweep), sd_y.copy()
    sd_y[:, f][rings[:, f]] *= np.sqrt(sweep.Y.shape[1])
    rings[:, f] = False
    sd_y[rings] = np.inf
    return sd_u, sd_i, sd_y


def _with_remanence(sds: tuple[Real, ...], sweep: Sweep, rig: Rig) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with the `wander` of the mean displacement."""
    sd_u, sd_i, sd_y = sds
    k, f, sd_y = sweep.harmonics.index(0), sweep.harmonics.index(1), sd_y.copy()
    mean_u, mean_y = sweep.U.mean(axis=1), sweep.Y.mean(axis=1)
    means = (mean_u, mean_u if sweep.I is None else sweep.I.mean(axis=1), mean_y)
    sd_y[:, k] = np.hypot(sd_y[:, k], wander(rig, means, sd_y[:, k], k, f, sweep))
    return sd_u, sd_i, sd_y


def _with_floor(sd: Real, mean: Complex, harmonics: tuple[int, ...], floor: float = MODEL_FLOOR) -> Real:
    """Standard deviation with the model's own error, relative to the size of each channel and harmonic."""
    relative = np.where(np.array(harmonics) > 1, HARMONIC_ERROR, 0.0)  # harmonic 0 holds the static position too
    relative[harmonics.index(1)] = floor
    smallest = SMALLEST_SHARE * np.abs(mean).max()  # a coarse converter may not scatter at all
    return np.asarray(np.maximum(np.hypot(sd, relative[:, None] * np.abs(mean)), smallest))


def _progress(sweep: Sweep, even: tuple[float, float], span_s: tuple[float, float] | None) -> Real:
    """Progress of each point, (P,): by its time where that is known, else evenly spaced."""
    if span_s is None or sweep.time_s is None:
        return np.linspace(*even, sweep.n_points)
    return np.asarray((sweep.time_s - span_s[0]) / (span_s[1] - span_s[0]))


def _with_hum(sds: tuple[Real, ...], sweep: Sweep, rig: Rig, hums_hz: Sequence[float]) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with what hums leave in input and output of each part of the loop."""
    if sweep.block_samples is None:  # unknown leakage: near a hum the mean counts as one block
        factor = np.where(near_hum(sweep, hums_hz)[..., None], np.sqrt(sweep.Y.shape[1]), 1.0)
        return tuple(sd * factor for sd in sds)
    u, i, y = (left_in_mean(sweep, X, hums_hz) for X in (sweep.U, sweep.U if sweep.I is None else sweep.I, sweep.Y))
    of_u, of_i, of_y = (sd.copy() for sd in sds)
    frequency, line = time_points(sweep.frequency_hz)
    for k, h in enumerate(sweep.harmonics):
        model = linear_model(rig, np.maximum(h * frequency, 1e-2))

        def through(G: Complex, x: Real, k: int = k) -> Real:
            """Rms amplitude of independent inputs x behind a response G, (P, n)."""
            return np.asarray(np.sqrt(np.einsum("pij,pj->pi", np.abs(G[line]) ** 2, x[:, k] ** 2)))

        C = model.controllers[:, :, None] * np.eye(rig.n_axes)
        of_u[:, k] = np.sqrt(of_u[:, k] ** 2 + u[:, k] ** 2 + through(C, y) ** 2)
        of_i[:, k] = np.sqrt(of_i[:, k] ** 2 + i[:, k] ** 2 + through(model.i_per_u, u) ** 2)
        of_y[:, k] = np.sqrt(of_y[:, k] ** 2 + y[:, k] ** 2 + through(model.y_per_u, u) ** 2)
    return of_u, of_i, of_y


def _with_transient_leakage(sds: tuple[Real, ...], sweep: Sweep, rig: Rig) -> tuple[Real, ...]:
    """Standard deviations of u, i and y with what slow transients leak into their harmonics, known from harmonic 0."""
    of_u, of_i, of_y = (sd.copy() for sd in sds)
    at_rest = sweep.harmonics.index(0)
    frequency, line = time_points(sweep.frequency_hz)
    U, Y = sweep.U[:, :, at_rest], sweep.Y[:, :, at_rest]
    for k, h in enumerate(sweep.harmonics):
        if h == 0:
            continue
        model = linear_model(rig, h * frequency)
        C = -model.controllers[line, :, None] * np.eye(rig.n_axes)
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
    """Harmonics of points within `RINGING` of a flexible mode, (P, H)."""
    modes = np.array([mode.natural_frequency_rad_s for plane in rig.rotor.modes for mode in plane]) / (2 * np.pi)
    at = sweep.frequency_hz[:, None] * np.array(sweep.harmonics)
    return np.asarray(np.any(np.abs(at[..., None] - modes) < RINGING * modes, axis=-1))


def _drift_leakage(sweep: Sweep, drift: Real) -> Real:
    """Residual of a law without a resonance for a signal that drifts so much over the blocks of a point, (P,)."""
    return np.asarray(drift * LEAKAGE_OF_DRIFT / (np.pi * periods(sweep) * sweep.Y.shape[1]))


def _drift(Y: Complex, sd: Real, blocks: int) -> Real:
    """Change of each point from its first block to its last beyond four standard deviations of noise, (P,), m."""
    change = np.abs(Y[:, -1] - Y[:, 0])
    return np.asarray(np.maximum(change - 4 * sd * np.sqrt(2 * blocks), 0.0).max(axis=1))


def _trend(X: Complex) -> Real:
    """Significant change of each point along the trend of its blocks, (P,), A; 0 where noise may make it.

    It is compared with the blocks' own scatter, not with sd_u or sd_i: feedback brings sensor noise into u and i, of
    which the residuals of controller and amplifiers have hardly any.
    """
    probability, change = trend(X)
    return np.asarray(np.where(probability < DRIFT_P_VALUE, change, 0.0).max(axis=1))
