"""Where the gap lies: block by block, band by band, channel by channel, each with a significance.

Every block of the loop is held against its own measured input, with only that block's uncertain values refitted:
the controller by R - C Y, the amplifiers by u, the plant by the measured coil current. So an error of one block
does not colour the next.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from service.gap.fit import COARSE, EXACT, MIDDLE, Problem
from service.gap.nuisance import Nuisance
from service.gap.observation import Observation
from service.gap.predict import answer, centred, control, measured, weights
from sim.rig import Rig
from sim.twin import linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PATHS = ("controller", "amplifier", "plant")
SIGNIFICANT = 5.0
"""Standard deviations, after the number of bands and channels looked at, beyond which a path has a gap."""


@dataclass(frozen=True)
class PathGap:
    """One block of the loop: ``gap`` is ||measured - twin|| / ||measured|| of its output."""

    path: str
    gap: float
    significance: float
    residual: Complex
    """(P, H, n) weighted"""
    logged: bool = True


@dataclass(frozen=True)
class Where:
    """Where the twin, its datasheet's values refitted, differs from the rig."""

    paths: tuple[PathGap, ...]
    bands: tuple[tuple[float, float, float], ...]
    """(from_hz, to_hz, gap)"""
    channels: tuple[tuple[str, str, float], ...]
    """(output, input, gap)"""
    harmonics: tuple[tuple[str, int, float], ...]
    """(signal, harmonic, significance) of what linear theory and the twin's magnets do not explain"""
    amplitude_dependent: bool
    speed_dependent: bool

    @property
    def path(self) -> str:
        """The block whose gap stands out most."""
        return max(self.paths, key=lambda p: p.significance).path


OUTLIER = 12.0
"""Largest squared residual (over its expectation) that one value adds to a cell."""


def driven_by_current(rig: Rig, o: Observation) -> Observation:
    """The observation with the control signal that would have made the measured current, and noise to match.

    Fitting y to it is fitting the plant alone.
    """
    assert o.I is not None
    U, sd_y = o.U.copy(), o.sd_y.copy()
    for k, h in enumerate(o.harmonics):
        model = linear_model(rig, np.maximum(h * o.frequency_hz, 1e-2))
        U[:, k] = np.linalg.solve(model.i_per_u[o.line], o.I[:, k, :, None])[..., 0]
        spread = np.abs(model.y_per_i[o.line]) ** 2 @ (o.sd_i[:, k, :, None] ** 2)
        sd_y[:, k] = np.sqrt(o.sd_y[:, k] ** 2 + spread[..., 0])
    return replace(o, U=U, sd_y=sd_y)


def significance(z: Complex, o: Observation, n_bands: int = 6, bound: float = OUTLIER) -> float:
    """Largest excess of mean square over bands and channels, as a one-sided normal deviate after Bonferroni.

    Residuals of one line's points share what is left of the twin's error, so a cell counts half its values.
    """
    edges = np.quantile(o.frequency_hz, np.linspace(0, 1, n_bands + 1))
    which = np.clip(np.searchsorted(edges, o.points_hz, side="right") - 1, 0, n_bands - 1)
    deviates = []
    for band in range(n_bands):
        # A few outliers at a sharp peak are not a gap: each value counts up to a bound.
        cell = np.minimum(np.abs(z[which == band]) ** 2 / 2, bound)  # mean one
        if not len(cell):
            continue
        mean = cell.reshape(len(cell), -1).mean(axis=0)
        deviates.append((mean - 1.0) * np.sqrt(len(cell) / 2))
    if not deviates:
        return 0.0
    values = np.concatenate(deviates)
    worst = float(values.max())
    if worst > 30:
        return worst
    p = min(1.0, float(norm.sf(worst)) * len(values))
    return float(max(norm.isf(p), 0.0)) if p < 1 else 0.0


def relative_gap(e: Complex, x: Complex) -> float:
    """||e|| / ||x||, 0 for nothing measured."""
    size = float(np.linalg.norm(x))
    return float(np.linalg.norm(e)) / size if size else 0.0


def locate(nuisance: Nuisance, observations: Sequence[Observation], held_out: Observation | None) -> Where:
    """Block residuals of the refitted twin on the first observation."""
    o, n, f = observations[0], nuisance.rig.n_axes, observations[0].fundamental
    zero, none = np.zeros(len(nuisance)), np.zeros(0)

    def fitted(case: Observation) -> Rig:
        theta = zero
        for stage in (COARSE, MIDDLE, EXACT):
            theta, _, fit = Problem(nuisance, [case]).run(theta, none, stage)
        return fit.rig

    silent = np.full_like(o.sd_y, np.inf)
    paths = []
    e_u = o.U - control(nuisance.rig, o)
    z_u = centred(np.concatenate([e_u] * 3, axis=2), weights(o), o)[..., :n] * weights(o)[..., :n]
    paths.append(
        PathGap("controller", relative_gap(e_u[:, f], o.U[:, f]), significance(z_u[:, [f]], o, bound=np.inf), z_u)
    )
    if o.I is None:
        rig = fitted(o)
        e, z = _plant_part(rig, o)
        paths.append(
            PathGap("plant", relative_gap(e[:, f], o.Y[:, f]), significance(z, o, bound=np.inf), z, logged=False)
        )
        harmonics = _harmonics({"y": z}, o)
    else:
        rig_i = fitted(replace(o, sd_y=silent))
        e_i = o.I - answer(rig_i, o)[..., :n]
        z_i = e_i * weights(o)[..., n : 2 * n]
        case = driven_by_current(rig_i, o)
        rig = fitted(replace(case, sd_i=silent))
        e, z = _plant_part(rig, driven_by_current(rig, o))
        paths.append(
            PathGap("amplifier", relative_gap(e_i[:, f], o.I[:, f]), significance(z_i[:, [f]], o, bound=np.inf), z_i)
        )
        paths.append(PathGap("plant", relative_gap(e[:, f], o.Y[:, f]), significance(z[:, [f]], o, bound=np.inf), z))
        harmonics = _harmonics({"i": z_i, "y": z}, o)
    edges = np.geomspace(o.frequency_hz[0] * 0.999, o.frequency_hz[-1] * 1.001, 7)
    bands = []
    for low, high in itertools.pairwise(edges):
        inside = (o.points_hz >= low) & (o.points_hz < high)
        if inside.any():
            bands.append((float(low), float(high), relative_gap(e[inside][:, f], o.Y[inside][:, f])))
    names = nuisance.rig.axes
    channels = [
        (names[a], names[b], relative_gap(e[o.axis == b][:, f, a], o.Y[o.axis == b][:, f, a]))
        for b in sorted(set(o.axis.tolist()))
        for a in range(n)
    ]
    strong = any(s > SIGNIFICANT for _, h, s in harmonics)
    return Where(tuple(paths), tuple(bands), tuple(channels), harmonics, strong, False)


def _plant_part(rig: Rig, o: Observation) -> tuple[Complex, Complex]:
    n = rig.n_axes
    predicted = np.concatenate([o.U, answer(rig, o)], axis=2)
    w = weights(o)
    e = centred(measured(o) - predicted, w, o)[..., 2 * n :]
    return e, e * w[..., 2 * n :]


def _harmonics(z: dict[str, Complex], o: Observation) -> tuple[tuple[str, int, float], ...]:
    return tuple(
        (signal, h, significance(values[:, [k]], o))
        for signal, values in z.items()
        for k, h in enumerate(o.harmonics)
        if h > 1
    )
