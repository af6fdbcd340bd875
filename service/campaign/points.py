"""Finished points of a campaign, and the experiment that they make. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.campaign.plan import Request
from service.experiment.data import Experiment, Sweep

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]

SWEEPS = ("main", "validation", "amplifier", "noise", "preliminary")
"""Sweeps of an experiment file, in order; the phase of a point names its sweep."""


@dataclass(frozen=True)
class Point:
    """One finished point. Arrays are (blocks, harmonics, n_axes)."""

    request: Request
    frequency_hz: float
    R: Complex
    U: Complex
    I: Complex
    Y: Complex
    peak_displacement_m: float
    """NaN where the controller tells none."""
    peak_current_a: float
    """The same."""
    time_s: float
    """Rig time at the end of the point, s from the campaign's start."""
    flag: str = ""
    kind: str = "stepped-sine"
    """Of a "multisine" only the excited line is kept: one harmonic."""
    phase_rad: Real | None = None
    """(blocks,) of a multisine, see `service.experiment.data.Sweep`."""
    kurtosis: Real | None = None
    """(n_axes,) of the same."""
    speed_rad_s: float | None = None
    """At which the rotor turned when it was measured; None where that is not known."""

    @property
    def excitation_a(self) -> complex:
        """R at harmonic 1 of the excited axis, mean of the blocks."""
        return complex(self.R[:, 1, self.request.axis].mean())

    def per_ampere(self) -> tuple[Complex, Complex, Complex]:
        """Mean U, I and Y at harmonic 1 per ampere of excitation, (n_axes,) each."""
        r = self.excitation_a
        return tuple(x[:, 1].mean(axis=0) / r for x in (self.U, self.I, self.Y))

    @property
    def excited(self) -> bool:
        """False for a point that could not be measured."""
        return abs(self.excitation_a) > 0


def unmeasured(request: Request, frequency_hz: float, n_axes: int, harmonics: int, time_s: float, why: str) -> Point:
    """A point that tripped at every amplitude: it stays in the sweep, with amplitude 0 and its flag."""
    zero = np.zeros((request.blocks, harmonics, n_axes), dtype=np.complex128)
    return Point(request.with_amplitude(0.0), frequency_hz, zero, zero, zero, zero, 0.0, 0.0, time_s, why)


def sweep(
    points: Sequence[Point],
    harmonics: tuple[int, ...],
    sample_rate_hz: float,
    speed_rad_s: float,
    comment: str,
) -> Sweep:
    """Points as one sweep, by frequency and then by axis."""
    ordered = sorted(points, key=lambda p: (p.frequency_hz, p.request.axis))
    kind = "noise" if comment == "noise" else ordered[0].kind
    return Sweep(
        kind=kind,
        frequency_hz=np.array([p.frequency_hz for p in ordered]),
        axis=np.array([p.request.axis for p in ordered], dtype=np.int64),
        amplitude_a=np.array([p.request.amplitude_a for p in ordered]),
        harmonics=(1,) if kind == "multisine" else harmonics,
        R=np.array([p.R for p in ordered]),
        U=np.array([p.U for p in ordered]),
        I=np.array([p.I for p in ordered]),
        Y=np.array([p.Y for p in ordered]),
        speed_rad_s=speed_rad_s,
        sample_rate_hz=sample_rate_hz,
        comment=comment,
        flags=tuple(p.flag for p in ordered),
        block_samples=np.array([p.request.samples for p in ordered], dtype=np.int64),
        time_s=np.array([p.time_s for p in ordered]),
        phase_rad=np.array([p.phase_rad for p in ordered]) if kind == "multisine" else None,
        kurtosis=ordered[0].kurtosis,
        point_speed_rad_s=_speeds(ordered, speed_rad_s),
    )


def _speeds(points: Sequence[Point], speed_rad_s: float) -> Real | None:
    """(P,) the campaign's where that of a point is not known; None where none is."""
    if all(p.speed_rad_s is None for p in points):
        return None
    return np.array([speed_rad_s if p.speed_rad_s is None else p.speed_rad_s for p in points])


def experiment(
    rig: str,
    axes: tuple[str, ...],
    phases: dict[str, list[Point]],
    harmonics: tuple[int, ...],
    sample_rate_hz: float,
    speed_rad_s: float,
    attributes: dict[str, str],
) -> Experiment:
    """All sweeps that have points, in the order of `SWEEPS`."""
    sweeps = tuple(
        sweep(phases[name], harmonics, sample_rate_hz, speed_rad_s, name) for name in SWEEPS if phases.get(name)
    )
    return Experiment(rig, axes, sweeps, attributes)


def responses(points: Sequence[Point], n_axes: int) -> tuple[Real, Complex, Complex]:
    """Frequencies at which every axis was excited, and there U and Y per ampere, (F, output, excited axis)."""
    by_frequency: dict[float, dict[int, Point]] = {}
    for p in points:
        if p.excited:
            by_frequency.setdefault(p.frequency_hz, {})[p.request.axis] = p
    frequencies = sorted(f for f, found in by_frequency.items() if len(found) == n_axes)
    columns = [[by_frequency[f][axis].per_ampere() for axis in range(n_axes)] for f in frequencies]
    stacked = np.array(columns).reshape(len(frequencies), n_axes, 3, n_axes)
    return np.array(frequencies), stacked[:, :, 0].swapaxes(1, 2), stacked[:, :, 2].swapaxes(1, 2)
