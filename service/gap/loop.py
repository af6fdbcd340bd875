"""What the gap means for the closed loop: sensitivity peaks predicted and measured, and the nu-gap by frequency.

The nu-gap of two loops is the largest chordal distance of their responses, and 1 where a condition on winding numbers
does not hold (Vinnicombe 2001, definition 3.1). Measured responses at some lines cannot show that condition, so the
value stated is a lower bound.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.predict import TINY_SIGNAL, at_speed_of
from service.gap.measured.observation import Observation
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import linear_model

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

QUANTITIES = ("sensitivity", "complementary_sensitivity", "dynamic_stiffness")
LEAST = ("dynamic_stiffness",)
"""Quantities whose smallest value counts; of the others the largest does."""
MATTERS = 0.05
"""Relative change over a point's blocks from which it is not used for a peak: 0.4 dB."""
NEAR_A_MODE, FINE = 0.03, 1e-4
"""Relative distance to a mode within which its peak lies in closed loop, and step of the frequencies there: where a
controller takes away almost all of a damping of 0.001, a peak is some 5e-4 wide."""
NOTHING: Mapping[str, Sequence[Rig]] = {}


def measured_responses(
    o: Observation, usable: NDArray[np.bool_]
) -> tuple[Complex, Complex, Complex, NDArray[np.int64]] | None:
    """u/r, y/u and y/r at the lines where every axis has a usable point, (F, n, n) each, and those lines.

    All points of a line count, by least squares. None where there are fewer than three such lines.
    """
    n, f = o.U.shape[2], o.fundamental
    lines = [k for k in range(len(o.frequency_hz)) if set(o.axis[(o.line == k) & usable].tolist()) == set(range(n))]
    if len(lines) < 3:
        return None
    at = [np.flatnonzero((o.line == k) & usable) for k in lines]
    pairs = ((o.U, o.R), (o.Y, o.U), (o.Y, o.R))
    u_r, y_u, y_r = (np.stack([A[p, f].T @ np.linalg.pinv(B[p, f].T) for p in at]) for A, B in pairs)
    return u_r, y_u, y_r, np.array(lines)


def settled(o: Observation) -> NDArray[np.bool_]:
    """Which points, (P,), are used for peaks: those that did not change by more than `MATTERS` while measured."""
    return ~(o.drifting & (o.drift > MATTERS))


def chordal_distance(a: Complex, b: Complex) -> Real:
    """Chordal distance of two loop matrices, (F, n, n) -> (F,): 0 if equal, 1 at most.

    Source: Vinnicombe, Uncertainty and Feedback, 2001, eq. 3.20.
    """

    def inverse_root(x: Complex) -> Complex:
        values, vectors = np.linalg.eigh(np.eye(x.shape[-1]) + x)
        return np.asarray((vectors / np.sqrt(values)[:, None, :]) @ np.conj(np.swapaxes(vectors, -1, -2)))

    left = inverse_root(b @ np.conj(np.swapaxes(b, -1, -2)))
    right = inverse_root(np.conj(np.swapaxes(a, -1, -2)) @ a)
    return np.asarray(np.linalg.norm(left @ (b - a) @ right, ord=2, axis=(1, 2)))


def loop_of(nuisance: Nuisance, before: Candidate, after: Candidate, o: Observation) -> dict[str, Any]:
    """`loop_figures` of two explanations, with deviations by twins that are drawn from both."""
    drawn = {"before": drawn_twins(nuisance, before), "after": drawn_twins(nuisance, after)}
    return loop_figures(before.fit.rig, after.fit.rig, o, drawn)


def loop_figures(
    before: Rig, after: Rig, o: Observation, drawn: Mapping[str, Sequence[Rig]] = NOTHING
) -> dict[str, Any]:
    """Figures of the loop by the twins before and after: S, T, dynamic stiffness, nu-gap at the measured lines.

    Parameters
    ----------
    drawn
        Twins "before" and "after" drawn from the posteriors of their values (`drawn_twins`), for the standard
        deviations of the predicted figures.
    """
    usable = settled(o)
    found = measured_responses(o, usable)
    if found is None:
        return {}
    S, G, y_per_r, lines = found
    axes, frequency = before.axes, o.frequency_hz[lines]
    twins = {"before": before, "after": after}
    force = Force(at_speed_of(before, o))
    measured = force.figures(S, y_per_r, frequency)
    noise = _noise(after, o, usable, lines, measured)
    at_lines = {name: _of_twin(rig, o, frequency, force) for name, rig in twins.items()}
    dense = _dense(frequency, [before, after])
    predicted = {name: _of_twin(rig, o, dense, force) for name, rig in twins.items()}
    spread = {name: [_of_twin(rig, o, dense, force) for rig in drawn.get(name, ())] for name in twins}
    gaps: dict[str, Any] = {"frequency_hz": frequency.tolist()}
    for name, rig in twins.items():
        model = linear_model(at_speed_of(rig, o), frequency)
        C = model.controllers[:, :, None]
        distance = chordal_distance(C * model.y_per_u, C * G)
        gaps[name] = distance.tolist()
        gaps[f"largest_{name}"] = float(distance.max())
    whole = measured_responses(o, np.ones(len(o.axis), dtype=bool))
    assert whole is not None  # it has all lines that had settled, and maybe more
    restless = np.setdiff1d(whole[3], lines)
    return {
        "sensitivity_peak": _peaks(axes, {"measured": measured, **at_lines}),
        "sensitivity_peak_with_not_settled": _with_not_settled(o, whole, twins, force) if len(restless) else None,
        "extremes": {
            quantity: {
                axis: {
                    "measured": _extreme(quantity, measured[quantity][:, a], frequency, noise[quantity][:, a]),
                    **{
                        name: _extreme(quantity, predicted[name][quantity][:, a], dense)
                        | {
                            "std": _std([_value(quantity, one[quantity][:, a]) for one in spread[name]]),
                            "at_measured_lines": _value(quantity, at_lines[name][quantity][:, a]),
                        }
                        for name in twins
                    },
                }
                for a, axis in enumerate(axes)
            }
            for quantity in QUANTITIES
        },
        "not_settled_hz": o.frequency_hz[restless].tolist(),
        "not_settled_change": float(o.drift[np.isin(o.line, restless) & ~usable].max(initial=0.0)),
        "not_every_axis_hz": np.delete(o.frequency_hz, whole[3]).tolist(),
        "nu_gap": gaps,
    }


def _peaks(axes: Sequence[str], found: Mapping[str, Mapping[str, Real]]) -> dict[str, dict[str, float]]:
    """Sensitivity peak of each axis, by source of the figures."""
    return {name: dict(zip(axes, of["sensitivity"].max(axis=0).tolist(), strict=True)) for name, of in found.items()}


def _with_not_settled(
    o: Observation, whole: tuple[Complex, Complex, Complex, NDArray[np.int64]], twins: Mapping[str, Rig], force: Force
) -> dict[str, dict[str, float]]:
    """Sensitivity peaks over all lines of ``whole``, of `measured_responses`: |S| peaks where a mode rings longest."""
    S, _, y_per_r, lines = whole
    frequency = o.frequency_hz[lines]
    at_lines = {name: _of_twin(rig, o, frequency, force) for name, rig in twins.items()}
    return _peaks(force.rig.axes, {"measured": force.figures(S, y_per_r, frequency), **at_lines})


@dataclass(frozen=True)
class Force:
    """Converts r to a force at the bearings, ki A r, by the same rig for all figures that are compared."""

    rig: Rig

    def figures(self, S: Complex, y_per_r: Complex, frequency_hz: Real) -> dict[str, Real]:
        """|S|, |T| and the dynamic stiffness in closed loop, N/m, of every axis by itself, (F, n) each."""
        force = _own(linear_model(self.rig, frequency_hz).i_per_u) * self.rig.magnets.ki
        own = _own(S)
        stiffness = np.abs(force) / np.maximum(np.abs(_own(y_per_r)), TINY_SIGNAL)
        return dict(zip(QUANTITIES, (np.abs(own), np.abs(1 - own), stiffness), strict=True))


def _of_twin(rig: Rig, o: Observation, frequency_hz: Real, force: Force) -> dict[str, Real]:
    model = linear_model(at_speed_of(rig, o), frequency_hz)
    u_per_r = model.u_per_r
    return force.figures(u_per_r, model.y_per_u @ u_per_r, frequency_hz)


def _own(of: Complex) -> Complex:
    """Each axis's response to its own excitation, (F, n, n) -> (F, n)."""
    return np.asarray(np.diagonal(of, axis1=1, axis2=2))


def _noise(
    rig: Rig, o: Observation, usable: NDArray[np.bool_], lines: NDArray[np.int64], measured: dict[str, Real]
) -> dict[str, Real]:
    """Standard deviation of the measured figures, (F, n) each, from the noise of the usable points.

    ``Observation.sd_u`` and ``sd_y`` are of the residuals e_u and e_y of controller and plant; in closed loop by
    ``rig`` u = S (e_u - C e_y), y = P S e_u + (I + P C)^-1 e_y.
    """
    f, n = o.fundamental, o.U.shape[2]
    of_u, of_y = np.zeros((len(lines), n)), np.zeros((len(lines), n))
    model = linear_model(at_speed_of(rig, o), o.frequency_hz[lines])
    S, C = model.u_per_r, model.controllers / model.log_phase[:, None]  # of the logged u
    u_per = (S, S * C[:, None, :])
    y_per = (model.y_per_u @ S, np.linalg.inv(np.eye(n) + model.y_per_u * C[:, None, :]))
    for row, k in enumerate(lines):
        for point in np.flatnonzero((o.line == k) & usable):
            a, e = o.axis[point], (o.sd_u[point, f], o.sd_y[point, f])
            scatter_u, scatter_y = (
                np.sqrt(sum(np.abs(G[row, a]) ** 2 @ sd**2 for G, sd in zip(per, e, strict=True)))
                for per in (u_per, y_per)
            )
            of_u[row, a] = scatter_u / abs(o.R[point, f, a])
            of_y[row, a] = scatter_y / max(abs(o.Y[point, f, a]), TINY_SIGNAL)
    # the magnitude of a complex mean has half of its variance
    root = np.sqrt(0.5)
    return dict(zip(QUANTITIES, (root * of_u, root * of_u, root * of_y * measured["dynamic_stiffness"]), strict=True))


def _dense(frequency_hz: Real, rigs: Sequence[Rig]) -> Real:
    """A grid over the measured band that is fine enough for the peaks of flexible modes."""
    low, high = float(frequency_hz[0]), float(frequency_hz[-1])
    modes = [m.natural_frequency_rad_s / (2 * np.pi) for rig in rigs for plane in rig.rotor.modes for m in plane]
    # one logarithmic grid for all modes, so that neighbouring modes share its points
    steps = np.unique([np.rint(np.log(m) / FINE) for m in modes]).astype(int)
    width = round(NEAR_A_MODE / FINE)
    near = np.exp(np.unique(steps[:, None] + np.arange(-width, width + 1)) * FINE)
    every = np.concatenate([np.geomspace(low, high, 300), frequency_hz, near])
    return np.unique(every[(every >= low) & (every <= high)])


def _value(quantity: str, of: Real) -> float:
    """The largest or, of `LEAST`, the smallest value."""
    return float(of.min() if quantity in LEAST else of.max())


def _extreme(quantity: str, of: Real, frequency_hz: Real, std: Real | None = None) -> dict[str, float]:
    k = int(of.argmin() if quantity in LEAST else of.argmax())
    extreme = {"value": float(of[k]), "frequency_hz": float(frequency_hz[k])}
    return extreme if std is None else extreme | {"std": float(std[k])}


def _std(values: Sequence[float]) -> float | None:
    return float(np.std(values, ddof=1)) if len(values) > 1 else None


def drawn_twins(nuisance: Nuisance, candidate: Candidate, count: int = 12, seed: int = 0) -> list[Rig]:
    """Twins with nuisance values drawn from their posterior; the effects stay as fitted."""
    k = len(nuisance)
    # The precision is at least that of the prior, one; rounding beside large curvatures must not make it less.
    precision, along = np.linalg.eigh(candidate.fit.curvature[:k, :k] + np.eye(k))
    root = along / np.sqrt(np.maximum(precision, 1.0))
    draws = np.random.default_rng(seed).standard_normal((count, k)) @ root.T
    out = []
    for draw in draws:
        rig = nuisance.at(candidate.fit.theta + draw)
        for name, values in zip(candidate.effects, candidate.fit.values, strict=True):
            rig = CATALOGUE[name].on(rig, **values)
        out.append(rig)
    return out
