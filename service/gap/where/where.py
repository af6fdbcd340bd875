"""Where the gap lies: by part of the loop, band and channel, each with a significance.

Every part is predicted from its own measured input, with only its own nuisance values refitted: the controller from
r and y, the amplifiers from u, the plant from the coil current. So an error of one part does not bias the next.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.predict import measured_signal, weight
from service.gap.interference import Interference
from service.gap.measured.observation import Observation
from service.gap.weighing.significance import SIGNIFICANT, significance, worst
from service.gap.where.dependence import Dependence, dependence
from service.gap.which.explained import Explained
from sim.effects import CATALOGUE

Complex = NDArray[np.complex128]

BANDS = 6
"""Number of bands, of equal width in log frequency, by which the gap is reported."""


@dataclass(frozen=True)
class PathGap:
    """One part of the loop: ``gap`` is ||measured - twin|| / ||measured|| of its output."""

    path: str
    gap: float
    significance: float
    logged: bool = True


@dataclass(frozen=True)
class Where:
    """Where the plain twin differs from the rig."""

    paths: tuple[PathGap, ...]
    bands: tuple[tuple[float, float, float, float], ...]
    """(from_hz, to_hz, gap, significance) of the blamed part"""
    channels: tuple[tuple[str, str, float, float], ...]
    """(output, input, gap, significance) of the blamed part"""
    harmonics: tuple[tuple[str, int, float], ...]
    """(signal, harmonic, significance) of the plain twin's residuals, its magnets' own harmonics being predicted"""
    depends: Dependence
    blamed: str
    """the part that bands, channels and dependence are of"""
    path: str
    """the part that no effect explains; else the path of the most significant gap on the fitted sweep, which may be
    that
    of interference; if none is significant there, the blamed part"""


def relative_gap(e: Complex, x: Complex) -> float:
    """||e|| / ||x||; 0 where x is zero."""
    size = float(np.linalg.norm(x))
    return float(np.linalg.norm(e)) / size if size else 0.0


def locate(
    found: Sequence[Explained],
    other: Observation,
    effects: Sequence[str] = (),
    sources: Sequence[Interference] = (),
    unexplained: str | None = None,
    nonlinear: bool = False,
) -> Where:
    """Where the plain twin fails, from the explanations of every part, the plant last, and from interference.

    Parameters
    ----------
    other
        The whole other sweep.
    effects
        Those that the verdict names. The part of the first one is blamed; without any, the part ``unexplained``, or
        else that of the most significant gap.
    unexplained
        The part that no effect explains, by the verdict.
    nonlinear
        Whether what no effect explains is nonlinear, by the verdict.
    """
    paths, harmonics = [], []
    for e in found:
        o, z = e.ground.observations[0], e.plain[0]
        signal, f = e.part.signal, o.fundamental
        error = unweighted(z, o, signal)
        gap = relative_gap(error[:, f], measured_signal(o, signal)[:, f])
        of_fundamental = significance(z[:, [f]], o, bound=np.inf)
        paths.append(PathGap(e.part.path, gap, of_fundamental, not e.part.from_control))
        if signal != "u":
            harmonics += [(signal, h, significance(z[:, [k]], o)) for k, h in enumerate(o.harmonics) if h > 1]
    most_significant = max(paths, key=lambda p: p.significance).path
    named = CATALOGUE[effects[0]].path if effects else unexplained or most_significant
    blamed = next((e for e in found if e.part.path == named), found[-1])
    distorted = any(s > SIGNIFICANT for _, _, s in harmonics)
    nonlinear = nonlinear or any(CATALOGUE[name].nonlinear for name in effects)
    depends = dependence(blamed, other, distorted or nonlinear)
    if "thermal_drift" in effects:  # the sweeps also differ in time
        depends = Dependence(distorted or nonlinear or None)
    o, f = found[-1].ground.observations[0], found[-1].ground.observations[0].fundamental
    for source in sources:
        amplitude = max(source.parameters[name] for name in source.parameters if name.startswith("amplitude"))
        measured = float(np.sqrt(np.mean(np.abs(measured_signal(o, source.signal)[:, f]) ** 2)))
        paths.append(PathGap("additive", amplitude / measured, source.significance))
    bands, channels = _bands(blamed), _channels(blamed)
    first = max(paths, key=lambda p: p.significance)
    path = unexplained or (first.path if first.significance > SIGNIFICANT else blamed.part.path)
    return Where(tuple(paths), bands, channels, tuple(harmonics), depends, blamed.part.path, path)


def _fundamental(e: Explained) -> tuple[Observation, Complex, Complex, Complex]:
    """The fitted sweep; weighted residuals, errors and measured signal of a part's fundamentals, (P, n) each."""
    o, f, signal = e.ground.observations[0], e.ground.observations[0].fundamental, e.part.signal
    return o, e.plain[0][:, f], unweighted(e.plain[0], o, signal)[:, f], measured_signal(o, signal)[:, f]


def _bands(e: Explained) -> tuple[tuple[float, float, float, float], ...]:
    """`Where.bands` of a part."""
    o, z, error, signal = _fundamental(e)
    edges = np.geomspace(o.frequency_hz[0] * 0.999, o.frequency_hz[-1] * 1.001, BANDS + 1)
    out = []
    for low, high in itertools.pairwise(edges):
        inside = (o.points_hz >= low) & (o.points_hz < high)
        if inside.any():
            of_band = worst([z[inside]], looked_at=BANDS)
            out.append((float(low), float(high), relative_gap(error[inside], signal[inside]), of_band))
    return tuple(out)


def _channels(e: Explained) -> tuple[tuple[str, str, float, float], ...]:
    """`Where.channels` of a part."""
    o, z, error, signal = _fundamental(e)
    names = e.ground.nuisance.rig.axes
    out = []
    for b in sorted(set(o.axis.tolist())):
        points = o.axis == b
        for a in range(len(names)):
            of_channel = worst([z[points, a]], looked_at=len(names) ** 2)
            out.append((names[a], names[b], relative_gap(error[points, a], signal[points, a]), of_channel))
    return tuple(out)


def unweighted(z: Complex, o: Observation, signal: str) -> Complex:
    """Residuals in A or m, (P, H, n), from weighted ones; 0 where the weight is."""
    w = weight(o, signal)
    return np.where(w > 0, z / np.maximum(w, 1e-300), 0)
