"""An experiment as arrays: what was excited, and what came back. No file format, no controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


@dataclass(frozen=True)
class Sweep:
    """Demodulated points of one sweep.

    R, U, I, Y: (P, B, H, n_axes) complex amplitudes of B consecutive blocks of whole periods,
    x(t) = Re(X exp(j h w t)), R at harmonic 1 real and positive. Several consecutive points may share a
    frequency (one per excited axis). A point with amplitude 0 was not excited.
    """

    kind: str
    """"stepped-sine", "multisine" or "noise"."""
    frequency_hz: Real
    """(P,)"""
    axis: NDArray[np.int64]
    """(P,) index of the excited axis."""
    amplitude_a: Real
    """(P,)"""
    harmonics: tuple[int, ...]
    R: Complex
    U: Complex
    I: Complex | None
    """None when the controller does not log the coil current."""
    Y: Complex
    speed_rad_s: float = 0.0
    sample_rate_hz: float = 10_000.0
    comment: str = ""
    flags: tuple[str, ...] = ()
    """Per point: "" or why it is marked ("repeated at lower amplitude", "not settled", ...); () for none."""
    block_samples: NDArray[np.int64] | None = None
    """(P,) length of a block, samples; None when the file does not tell."""
    time_s: Real | None = None
    """(P,) rig time at which the point was measured, s from the campaign's start; None when the file does not tell."""
    phase_rad: Real | None = None
    """(P, B) of a multisine on all axes at once: phase that r of the point's axis had in each block, before the time
    origin was moved. Experiment e of a block played r_j = W[e, j] x_j with W = `multisine.orthogonal` of the number of
    axes, and the points are what the separation of the experiments gave. None for what excites one axis at a time."""

    kurtosis: Real | None = None
    """(n_axes,) of such a multisine: E[y^4] / (3 E[y^2]^2), 1 for a Gaussian signal."""
    point_speed_rad_s: Real | None = None
    """(P,) at which the rotor turned when each point was measured; None when the file does not tell."""

    @property
    def n_points(self) -> int:
        """P."""
        return len(self.frequency_hz)

    def harmonic(self, h: int) -> int:
        """Index of harmonic ``h`` in the arrays; ValueError when it was not measured."""
        return self.harmonics.index(h)

    @property
    def in_sequence(self) -> bool:
        """Whether the blocks of a point followed one another: those of a multisine are made of several experiments."""
        return self.kind != "multisine"

    def select(self, points: NDArray[np.bool_] | NDArray[np.int64]) -> Sweep:
        """The sweep with some of its points, in order."""
        index = np.arange(self.n_points)[points]
        return Sweep(
            kind=self.kind,
            frequency_hz=self.frequency_hz[index],
            axis=self.axis[index],
            amplitude_a=self.amplitude_a[index],
            harmonics=self.harmonics,
            R=self.R[index],
            U=self.U[index],
            I=None if self.I is None else self.I[index],
            Y=self.Y[index],
            speed_rad_s=self.speed_rad_s,
            sample_rate_hz=self.sample_rate_hz,
            comment=self.comment,
            flags=tuple(self.flags[k] for k in index) if self.flags else (),
            block_samples=None if self.block_samples is None else self.block_samples[index],
            time_s=None if self.time_s is None else self.time_s[index],
            phase_rad=None if self.phase_rad is None else self.phase_rad[index],
            kurtosis=self.kurtosis,
            point_speed_rad_s=None if self.point_speed_rad_s is None else self.point_speed_rad_s[index],
        )

    def with_blocks(self, blocks: Sequence[int]) -> Sweep:
        """The sweep with some blocks of each point, in order."""
        index = list(blocks)
        return replace(
            self,
            R=self.R[:, index],
            U=self.U[:, index],
            I=None if self.I is None else self.I[:, index],
            Y=self.Y[:, index],
            phase_rad=None if self.phase_rad is None else self.phase_rad[:, index],
        )


@dataclass(frozen=True)
class Experiment:
    """A whole experiment file: the main sweep first, others (validation, amplifier, noise) by their comment.

    ``comment`` tells what a sweep is for: "main" (plant, 10-1000 Hz), "amplifier" (each amplifier up to 3 kHz),
    "validation" or any other (unseen by every fit), and kind "noise" for the zero-excitation record.
    """

    rig: str
    axes: tuple[str, ...]
    sweeps: tuple[Sweep, ...]
    attributes: dict[str, str] = field(default_factory=dict)

    @property
    def main(self) -> Sweep:
        """The first excited sweep."""
        return next(s for s in self.sweeps if s.kind != "noise")

    @property
    def rig_seconds(self) -> float | None:
        """Time that the rig was busy, s; None where the file does not tell it as a plain number.

        An attribute is free text of whoever wrote the file: nothing that is known without it may depend on it.

        >>> Experiment("r", (), (), {"rig_seconds": "1503.2"}).rig_seconds
        1503.2
        >>> Experiment("r", (), (), {"rig_seconds": "25 min"}).rig_seconds
        """
        try:
            seconds = float(self.attributes.get("rig_seconds", ""))
        except ValueError:
            return None
        return seconds if math.isfinite(seconds) and seconds >= 0 else None

    def named(self, comment: str) -> Sweep | None:
        """The first sweep with that comment, or None."""
        return next((s for s in self.sweeps if s.comment == comment), None)
