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

from service.gap.interference import Interference
from service.gap.observation import Observation
from service.gap.predict import measured_signal, weight
from service.gap.search import Explained
from service.gap.significance import significance

Complex = NDArray[np.complex128]

SIGNIFICANT = 5.0
"""Standard deviations, after the number of bands and channels looked at, beyond which a part has a gap."""


@dataclass(frozen=True)
class PathGap:
    """One part of the loop: ``gap`` is ||measured - twin|| / ||measured|| of its output."""

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
        """The part whose gap stands out most."""
        return max(self.paths, key=lambda p: p.significance).path


def relative_gap(e: Complex, x: Complex) -> float:
    """||e|| / ||x||, 0 for nothing measured."""
    size = float(np.linalg.norm(x))
    return float(np.linalg.norm(e)) / size if size else 0.0


def locate(found: Sequence[Explained], amplitude_dependent: bool, sources: Sequence[Interference] = ()) -> Where:
    """Where the plain twin fails, from what the search left of every part, plant last, and from interference."""
    paths, harmonics = [], []
    for e in found:
        o, z = e.ground.observations[0], e.plain[0]
        signal, f = e.part.signal, o.fundamental
        error = unweighted(z, o, signal)
        gap = relative_gap(error[:, f], measured_signal(o, signal)[:, f])
        own = significance(z[:, [f]], o, bound=np.inf)
        paths.append(PathGap(e.part.path, gap, own, z, not e.part.from_control))
        if signal != "u":
            harmonics += [(signal, h, significance(z[:, [k]], o)) for k, h in enumerate(o.harmonics) if h > 1]
    o, f = found[-1].ground.observations[0], found[-1].ground.observations[0].fundamental
    edges = np.geomspace(o.frequency_hz[0] * 0.999, o.frequency_hz[-1] * 1.001, 7)
    bands = []
    for low, high in itertools.pairwise(edges):
        inside = (o.points_hz >= low) & (o.points_hz < high)
        if inside.any():
            bands.append((float(low), float(high), relative_gap(error[inside][:, f], o.Y[inside][:, f])))
    names = found[-1].ground.nuisance.rig.axes
    channels = [
        (names[a], names[b], relative_gap(error[o.axis == b][:, f, a], o.Y[o.axis == b][:, f, a]))
        for b in sorted(set(o.axis.tolist()))
        for a in range(len(names))
    ]
    for source in sources:
        amplitude = max(source.parameters[name] for name in source.parameters if name.startswith("amplitude"))
        measured = float(np.sqrt(np.mean(np.abs(measured_signal(o, source.signal)[:, f]) ** 2)))
        paths.append(PathGap("additive", amplitude / measured, source.significance, np.zeros_like(o.Y)))
    distorted = any(s > SIGNIFICANT for _, _, s in harmonics)
    return Where(tuple(paths), tuple(bands), tuple(channels), tuple(harmonics), amplitude_dependent or distorted, False)


def unweighted(z: Complex, o: Observation, signal: str) -> Complex:
    """Residuals in A or m, (P, H, n); 0 where nothing was weighed."""
    w = weight(o, signal)
    return np.where(w > 0, z / np.maximum(w, 1e-300), 0)
