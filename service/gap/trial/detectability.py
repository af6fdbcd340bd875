"""Detectability: how plainly a withheld effect shows in an experiment, beside which every score of a trial is stated.

The experiment's tones are replayed on the rig with and without what is withheld, both without noise. The change is
whitened by the experiment's noise, and what errors of the datasheet within its tolerances could imitate is taken off:
the minimum over theta of |W (change - J theta)|^2 + |theta / sigma|^2. Its root is about the number of standard
deviations by which the effect stands out for a test that knows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from service.experiment.data import Sweep
from service.gap.measured.observation import MODEL_FLOOR
from sim import control_law
from sim.datasheet import Tolerance
from sim.errors import LevitationError
from sim.loop import Loop
from sim.rig import Array, FlexibleMode, Noise, Rig
from sim.stepping import Simulation
from sim.twin import linear_model

Complex = NDArray[np.complex128]

BLOCKS = 2
"""Blocks of a replayed tone."""
SETTLE_S, LONGEST_SETTLE_S = 0.3, 1.5
"""Time that a tone waits, least and most."""
RUNG_OUT = 4.0
"""Time constants of a mode that a tone near it waits, by its fundamental or by a harmonic."""
NEAR_MODE = 0.1
"""Relative distance from a mode within which a tone that ramps up in `RAMP_S` leaves it ringing."""
RAMP_S = 0.1
BLOCK_S = 0.05
STEP = 1e-3
"""Step of a nuisance value for derivatives, in its standard deviations."""
ROUNDS = 20
"""Most evaluations of a least-squares fit of the nuisance values."""
REPLAYS, CLOSER = 10, 0.8
"""Most replays of the nearest rig within the tolerances, and the factor by which the cost must fall for a further
one."""
PLAIN = 1e9
"""Largest detectability, as of what decides whether the rig levitates."""
MEDIAN = 0.87
"""Median of a variance of some six blocks over its expectation."""


@dataclass(frozen=True)
class Replayed:
    """Amplitudes of a sweep's tones on a rig without noise: (P, H, n) each."""

    R: Complex
    U: Complex
    I: Complex
    Y: Complex


def quiet(rig: Rig, steps: bool = False) -> Rig:
    """The rig without measurement noise; ``steps`` keeps the resolution of its sensors."""
    n = rig.noise
    kept = Noise(0.0, 0.0, n.displacement_step_m, n.current_step_a) if steps else Noise()
    return replace(rig, noise=kept)


def settle_s(rigs: Sequence[Rig], sweep: Sweep) -> Array:
    """Time that each of a sweep's tones is to wait on any of ``rigs``, (P,), s: long where a mode would still ring."""
    wait = np.full(sweep.n_points, SETTLE_S)
    for rig in rigs:
        z = np.linalg.eigvals(Loop(rig, 1).closed_loop())
        s = np.log(z[np.imag(z) > 0]) / rig.controller.sample_time_s
        hz = np.imag(s) / (2 * np.pi)
        tones = sweep.frequency_hz[:, None] * np.array([h for h in sweep.harmonics if h])
        near = (np.abs(tones[..., None] - hz) < NEAR_MODE * hz).any(axis=1)
        wait = np.maximum(wait, np.where(near, -RUNG_OUT / np.real(s), 0.0).max(axis=1, initial=0.0))
    return np.asarray(np.minimum(wait, LONGEST_SETTLE_S))


def replay(simulation: Simulation, sweep: Sweep, settled_s: Array) -> Replayed:
    """Play a sweep's tones, in order, and demodulate them over whole periods, ``settled_s`` (P,) after they began."""
    fs, n = 1 / simulation.rig.controller.sample_time_s, simulation.n_axes
    out: dict[str, list[Complex]] = {name: [] for name in "RUIY"}
    for f, axis, amplitude, wait in zip(sweep.frequency_hz, sweep.axis, sweep.amplitude_a, settled_s, strict=True):
        periods, samples = _block(float(f), fs)
        settle, ramp = round(float(wait) * fs), round(RAMP_S * fs)
        k = np.arange(-settle - ramp, BLOCKS * samples + ramp)
        end = BLOCKS * samples
        level = np.clip(np.minimum((k + settle + ramp) / ramp, (end + ramp - k) / ramp), 0.0, 1.0)
        r = np.zeros((len(k), n))
        r[:, axis] = amplitude * level * np.cos(2 * np.pi * periods * k / samples)
        record = simulation.advance(r, check_limits=False)
        taken = slice(settle + ramp, settle + ramp + end)
        t = np.arange(end)
        for name, x in zip("RUIY", (record.r, record.u, record.i, record.y), strict=True):
            basis = [np.exp(-2j * np.pi * h * periods * t / samples) * (2 if h else 1) / end for h in sweep.harmonics]
            out[name].append(np.asarray(np.array(basis) @ x[taken]))
    return Replayed(**{name: np.array(rows) for name, rows in out.items()})


def duration_s(sweep: Sweep, settled_s: Array, sample_rate_hz: float) -> float:
    """Time on the rig that `replay` takes."""
    blocks = sum(BLOCKS * _block(float(f), sample_rate_hz)[1] for f in sweep.frequency_hz)
    return blocks / sample_rate_hz + float(np.sum(settled_s + 2 * RAMP_S))


def _block(frequency_hz: float, sample_rate_hz: float) -> tuple[int, int]:
    """Whole periods in whole samples that come within 1e-5 of a frequency, in blocks of some 50 ms."""
    first = max(1, round(frequency_hz * BLOCK_S))
    best = (first, round(first * sample_rate_hz / frequency_hz))
    error = np.inf
    for periods in range(first, first + 40):
        samples = round(periods * sample_rate_hz / frequency_hz)
        now = abs(periods * sample_rate_hz / samples / frequency_hz - 1)
        if now < error:
            best, error = (periods, samples), now
        if error < 1e-5:
            break
    return best


Move = Callable[[Rig, float], Rig]
"""(rig, change) -> rig with one value of its datasheet moved; what is positive changes by its logarithm."""


def uncertain_values(rig: Rig, tolerance: Tolerance) -> list[tuple[Move, float]]:
    """Values that the datasheet may have wrong, each with its one-sigma error."""

    def axis_value(part: str, name: str, axis: int) -> Move:
        def move(r: Rig, x: float) -> Rig:
            whole = getattr(r, part)
            values = np.array(getattr(whole, name), dtype=float)
            values[axis] *= math.exp(x)
            return replace(r, **{part: replace(whole, **{name: values})})

        return move

    def rotor_value(name: str) -> Move:
        return lambda r, x: replace(r, rotor=replace(r.rotor, **{name: getattr(r.rotor, name) * math.exp(x)}))

    def sensor(end: int) -> Move:
        def move(r: Rig, x: float) -> Rig:
            at = list(r.rotor.sensor_from_cog_m)
            at[end] += x
            return replace(r, rotor=replace(r.rotor, sensor_from_cog_m=(at[0], at[1])))

        return move

    out: list[tuple[Move, float]] = []
    for axis in range(rig.n_axes):
        out += [
            (axis_value("magnets", "ki", axis), tolerance.current_stiffness),
            (axis_value("magnets", "ks", axis), tolerance.position_stiffness),
            (axis_value("amplifiers", "natural_frequency_rad_s", axis), tolerance.amplifier_frequency),
            (axis_value("amplifiers", "gain", axis), tolerance.amplifier_gain),
            (axis_value("sensors", "gain", axis), tolerance.sensor_gain),
        ]
        if rig.amplifiers.damping_ratio is not None:
            out.append((axis_value("amplifiers", "damping_ratio", axis), tolerance.amplifier_damping))
    out.append((rotor_value("mass_kg"), tolerance.mass))
    out.append((rotor_value("transverse_inertia_kgm2"), tolerance.transverse_inertia))
    out += [(sensor(end), tolerance.sensor_position_m) for end in (0, 1)]
    for plane, modes in enumerate(rig.rotor.modes):  # a datasheet's mode is that of either plane within its tolerance
        for k in range(len(modes)):
            out += _mode_values(plane, k, tolerance)
    return out


def _mode_values(plane: int, k: int, t: Tolerance) -> list[tuple[Move, float]]:
    def moved(change: Callable[[FlexibleMode, float], FlexibleMode]) -> Move:
        def move(r: Rig, x: float) -> Rig:
            modes = [list(p) for p in r.rotor.modes]
            modes[plane][k] = change(modes[plane][k], x)
            return replace(r, rotor=replace(r.rotor, modes=tuple(map(tuple, modes))))

        return move

    def scaled(name: str) -> Callable[[FlexibleMode, float], FlexibleMode]:
        return lambda m, x: replace(m, **{name: getattr(m, name) * math.exp(x)})

    def shape(name: str, end: int) -> Callable[[FlexibleMode, float], FlexibleMode]:
        def change(m: FlexibleMode, x: float) -> FlexibleMode:
            v = list(getattr(m, name))
            v[end] *= 1 + x
            pair: Any = (v[0], v[1])
            return replace(m, **{name: pair})

        return change

    found: list[tuple[Move, float]] = [
        (moved(scaled("natural_frequency_rad_s")), t.mode_frequency),
        (moved(scaled("damping_ratio")), t.mode_damping),
    ]
    for end in (0, 1):
        found += [(moved(shape(n, end)), t.mode_shape) for n in ("shape_at_bearings", "shape_at_sensors")]
    return found


def _signals(R: Complex, U: Complex, I: Complex, Y: Complex, C: Complex) -> Complex:
    """Controller residual, current and displacement side by side, (..., 3 n)."""
    return np.concatenate([U - R + C * Y, I, Y], axis=-1)


def _model(rig: Rig, sweep: Sweep, lines: Array, at: NDArray[np.int64]) -> Complex:
    """Small-signal response of a rig to the sweep's tones, as `_signals`, (P, 3 n)."""
    m = linear_model(rig, lines)
    U = m.u_per_r
    C = m.controllers[:, :, None]
    Y = m.y_per_u @ U
    response = np.concatenate([U - np.eye(rig.n_axes) + C * Y, m.i_per_u @ U, Y], axis=1)
    return np.asarray(response[at, :, sweep.axis] * sweep.amplitude_a[:, None])


def _whitening(blocks: Complex, size: Array, at: NDArray[np.int64], n_lines: int) -> Complex:
    """(P, 3n, 3n): root of the inverse covariance of the mean over blocks, pooled over inputs and neighbouring lines.

    A share of `MODEL_FLOOR` of the signals' ``size`` (P, 3n) counts as noise.
    """
    noise = blocks - blocks.mean(axis=1, keepdims=True)
    n_blocks, n = blocks.shape[1:]
    per_line = np.empty((n_lines, n, n), dtype=complex)
    for line in range(n_lines):
        near = np.abs(at - line) <= 1
        e = noise[near].reshape(-1, n)
        scale = np.sqrt((np.abs(e) ** 2).mean(axis=0)) + 1e-300
        cov = (e / scale).T @ (e / scale).conj() / (near.sum() * (n_blocks - 1)) / n_blocks
        floor = MODEL_FLOOR * np.sqrt((size[near] ** 2).mean(axis=0)) / scale
        per_line[line] = np.linalg.inv(np.linalg.cholesky(cov + np.diag(1e-3 / n_blocks + floor**2))) / scale
    return per_line[at]


def detectability(
    plain: Rig,
    tolerance: Tolerance,
    sweeps: Sequence[tuple[Sweep, Replayed]],
    replayed: Callable[[Rig], Sequence[Replayed]],
) -> float:
    """Standard deviations by which what is withheld stands out from noise and the datasheet's tolerances.

    Parameters
    ----------
    plain : Rig
        Without what is withheld.
    tolerance : Tolerance
    sweeps
        (as measured, replayed with what is withheld).
    replayed
        The same sweeps replayed on any rig without what is withheld.
    """
    parts = uncertain_values(plain, tolerance)
    grids = [np.unique(s.frequency_hz, return_inverse=True) for s, _ in sweeps]
    laws = [control_law.response(plain.controller, 2 * np.pi * s.frequency_hz)[:, None] for s, _ in sweeps]
    roots = [_noise(s, C, at, len(f)) for (s, _), C, (f, at) in zip(sweeps, laws, grids, strict=True)]

    def moved(theta: Array) -> Rig:
        rig = plain
        for (move, sigma), x in zip(parts, theta, strict=True):
            rig = move(rig, sigma * x) if x else rig
        return rig

    def whitened(x: Sequence[Complex]) -> Array:
        y = np.concatenate([np.einsum("pab,pb->pa", w, e).ravel() for w, e in zip(roots, x, strict=True)])
        return np.asarray(np.sqrt(2) * np.concatenate([y.real, y.imag]))

    def model(theta: Array) -> Array:
        return whitened([_model(moved(theta), s, *g) for (s, _), g in zip(sweeps, grids, strict=True)])

    def change(theta: Array) -> tuple[Array, float]:
        pairs = [(s, with_it, w) for (s, with_it), w in zip(sweeps, replayed(moved(theta)), strict=True)]
        first = whitened([_fundamental(s, C, *both) for (s, *both), C in zip(pairs, laws, strict=True)])
        return first, sum(_harmonics(*pair) for pair in pairs)

    # Gauss-Newton: the linear model gives the rig within the tolerances that imitates the change best, and a replay
    # with nonlinear magnets shows how close it comes.
    theta, least = np.zeros(len(parts)), np.inf
    for k in range(REPLAYS):
        try:
            first, others = change(theta)
        except LevitationError:  # such a rig cannot have been measured
            if k:
                break
            raise
        with np.errstate(over="ignore", invalid="ignore"):  # it may lose levitation during the replay
            cost = float(first @ first + theta @ theta) + others
        if not cost < CLOSER * least:
            break
        least = cost
        theta = _nearest(first, model, theta)
    return float(np.sqrt(min(least, PLAIN**2)))


def _nearest(change: Array, model: Callable[[Array], Array], theta: Array) -> Array:
    """Deviations from the datasheet that minimise a change seen at ``theta`` plus their own penalty."""
    nominal, n = model(theta), len(theta)

    def left(x: Array) -> Array:
        return np.concatenate([change - (model(x) - nominal), x])

    def slope(x: Array) -> Array:
        here = left(x)
        return np.array([(left(x + STEP * e) - here) / STEP for e in np.eye(n)]).T

    # iterated, as near a resonance the model is nonlinear within the tolerances
    return np.asarray(scipy.optimize.least_squares(left, theta, slope, ftol=1e-3, max_nfev=ROUNDS).x)


def _noise(sweep: Sweep, C: Complex, at: NDArray[np.int64], n_lines: int) -> Complex:
    """Whitening of a sweep's signals, (P, 3n, 3n)."""
    f, I = sweep.harmonic(1), sweep.U if sweep.I is None else sweep.I
    R, U, I, Y = (X[:, :, f] for X in (sweep.R, sweep.U, I, sweep.Y))
    size = np.abs(np.concatenate([X.mean(axis=1) for X in (U, I, Y)], axis=-1))
    return _whitening(_signals(R, U, I, Y, C[:, None]), size, at, n_lines)


def _fundamental(sweep: Sweep, C: Complex, with_it: Replayed, without: Replayed) -> Complex:
    """Change of a sweep's signals at the excited frequency, (P, 3n)."""
    f = sweep.harmonic(1)
    dR, dU, dI, dY = (getattr(with_it, name)[:, f] - getattr(without, name)[:, f] for name in "RUIY")
    return _signals(dR, dU, dI, dY, C)


def _harmonics(sweep: Sweep, with_it: Replayed, without: Replayed) -> float:
    """Squared norm of the change of the other harmonics, in standard deviations of their noise."""
    I, total = sweep.U if sweep.I is None else sweep.I, 0.0
    for k, h in enumerate(sweep.harmonics):
        if h == 1:
            continue
        for X, d in ((I, with_it.I - without.I), (sweep.Y, with_it.Y - without.Y)):
            variance = np.median(X[:, :, k].var(axis=1, ddof=1), axis=0) / X.shape[1] / MEDIAN
            total += float((np.abs(d[:, k]) ** 2 / (variance + 1e-300)).sum())
    return 2 * total
