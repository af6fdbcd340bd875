"""Where the gap lies: part by part, band by band, channel by channel, each with a significance.

Every part of the loop is held against its own measured input, with only that part's uncertain values refitted:
the controller by R - C Y, the amplifiers by u, the plant by the measured coil current. So an error of one part
does not colour the next.
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
"""Bands, evenly wide in log frequency, by which the gap is told."""


@dataclass(frozen=True)
class PathGap:
    """One part of the loop: ``gap`` is ||measured - twin|| / ||measured|| of its output."""

    path: str
    gap: float
    significance: float
    logged: bool = True


@dataclass(frozen=True)
class Where:
    """Where the twin, its datasheet's values refitted, differs from the rig."""

    paths: tuple[PathGap, ...]
    bands: tuple[tuple[float, float, float, float], ...]
    """(from_hz, to_hz, gap, significance) of the blamed part"""
    channels: tuple[tuple[str, str, float, float], ...]
    """(output, input, gap, significance) of the blamed part"""
    harmonics: tuple[tuple[str, int, float], ...]
    """(signal, harmonic, significance) of what linear theory and the twin's magnets do not explain"""
    depends: Dependence
    blamed: str
    """the part that bands, channels and dependence are of"""
    path: str
    """the part that nothing explains; else the one whose gap stands out most on the fitted sweep, interference among
    them; where none does there, the one that is blamed"""


def relative_gap(e: Complex, x: Complex) -> float:
    """||e|| / ||x||, 0 for nothing measured."""
    size = float(np.linalg.norm(x))
    return float(np.linalg.norm(e)) / size if size else 0.0


def locate(
    found: Sequence[Explained],
    other: Observation,
    effects: Sequence[str] = (),
    sources: Sequence[Interference] = (),
    unexplained: str | None = None,
    bent: bool = False,
) -> Where:
    """Where the plain twin fails, from what the search left of every part, plant last, and from interference.

    Parameters
    ----------
    other
        The other sweep, all of it.
    effects
        What the verdict names; the part of the first one is blamed, else the part whose gap stands out most.
    unexplained
        The part that the verdict says nothing explains; it is blamed however plain the gap of another one is.
    bent
        Whether the verdict says that what is not explained is not in proportion to the excitation.
    """
    paths, harmonics = [], []
    for e in found:
        o, z = e.ground.observations[0], e.plain[0]
        signal, f = e.part.signal, o.fundamental
        error = unweighted(z, o, signal)
        gap = relative_gap(error[:, f], measured_signal(o, signal)[:, f])
        own = significance(z[:, [f]], o, bound=np.inf)
        paths.append(PathGap(e.part.path, gap, own, not e.part.from_control))
        if signal != "u":
            harmonics += [(signal, h, significance(z[:, [k]], o)) for k, h in enumerate(o.harmonics) if h > 1]
    plainest = max(paths, key=lambda p: p.significance).path
    named = CATALOGUE[effects[0]].path if effects else unexplained or plainest
    blamed = next((e for e in found if e.part.path == named), found[-1])
    distorted = any(s > SIGNIFICANT for _, _, s in harmonics)
    bent = bent or any(CATALOGUE[name].nonlinear for name in effects)
    depends = dependence(blamed, other, distorted or bent)
    if "thermal_drift" in effects:  # the sweeps differ in time too
        depends = Dependence(distorted or bent or None)
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
    """A part on the fitted sweep: weighted residuals, errors and measured signal, (P, n) each."""
    o, f, signal = e.ground.observations[0], e.ground.observations[0].fundamental, e.part.signal
    return o, e.plain[0][:, f], unweighted(e.plain[0], o, signal)[:, f], measured_signal(o, signal)[:, f]


def _bands(e: Explained) -> tuple[tuple[float, float, float, float], ...]:
    o, z, error, seen = _fundamental(e)
    edges = np.geomspace(o.frequency_hz[0] * 0.999, o.frequency_hz[-1] * 1.001, BANDS + 1)
    out = []
    for low, high in itertools.pairwise(edges):
        inside = (o.points_hz >= low) & (o.points_hz < high)
        if inside.any():
            sure = worst([z[inside]], looked_at=BANDS)
            out.append((float(low), float(high), relative_gap(error[inside], seen[inside]), sure))
    return tuple(out)


def _channels(e: Explained) -> tuple[tuple[str, str, float, float], ...]:
    o, z, error, seen = _fundamental(e)
    names = e.ground.nuisance.rig.axes
    out = []
    for b in sorted(set(o.axis.tolist())):
        of = o.axis == b
        for a in range(len(names)):
            sure = worst([z[of, a]], looked_at=len(names) ** 2)
            out.append((names[a], names[b], relative_gap(error[of, a], seen[of, a]), sure))
    return tuple(out)


def unweighted(z: Complex, o: Observation, signal: str) -> Complex:
    """Residuals in A or m, (P, H, n); 0 where nothing was weighed."""
    w = weight(o, signal)
    return np.where(w > 0, z / np.maximum(w, 1e-300), 0)
