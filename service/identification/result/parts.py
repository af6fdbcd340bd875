"""The parts of a plane's result: amplifiers, modes, roots, and the curves that show how good they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.measured.etfe import FrequencyResponse
from service.identification.statistics.estimate import Estimate
from service.identification.statistics.evidence import Evidence


@dataclass(frozen=True)
class AmplifierResult:
    """One amplifier as refined."""

    order: int
    poles: Complex
    dc_gain: float
    parameters: dict[str, Estimate]
    fit_percent: float
    """NRMSE of the sampled model against the measured i/u."""
    first_order_fit_percent: float
    evidence: tuple[Evidence, ...]
    first_order: tuple[tuple[float, ...], float] | None = None
    """Parameters (gain, w) and delay, s, of the first-order model beside it, computing delay included."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "order": self.order,
            "poles_rad_s": [[float(p.real), float(p.imag)] for p in self.poles],
            "dc_gain": self.dc_gain,
            "fit_percent": self.fit_percent,
            "first_order_fit_percent": self.first_order_fit_percent,
            "parameters": {k: v.document() for k, v in self.parameters.items()},
            "evidence": [e.document() for e in self.evidence],
        }


@dataclass(frozen=True)
class ModeResult:
    """A flexible mode of the free rotor."""

    natural_frequency_rad_s: Estimate
    damping_ratio: Estimate
    levitated_frequency_rad_s: Estimate
    """Of the plant's pole, with the position stiffness at work."""
    shape_at_bearings: tuple[Estimate, Estimate]
    shape_at_sensors: tuple[Estimate, Estimate]
    kind: str
    """"rotor", or "beyond" for one that stands for what lies outside the band, or "patch" without a peak."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "natural_frequency_rad_s": self.natural_frequency_rad_s.document(),
            "damping_ratio": self.damping_ratio.document(),
            "levitated_frequency_rad_s": self.levitated_frequency_rad_s.document(),
            "shape_at_bearings": [e.document() for e in self.shape_at_bearings],
            "shape_at_sensors": [e.document() for e in self.shape_at_sensors],
            "kind": self.kind,
        }


@dataclass(frozen=True)
class RootResult:
    """A pole or a zero of the levitated plant, rad/s, and the region where it lies."""

    value: complex
    std: float
    """Standard deviation of |dp|."""
    covariance: Real
    """(2, 2) of real and imaginary part."""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "re": self.value.real,
            "im": self.value.imag,
            "std": self.std,
            "covariance": self.covariance.tolist(),
        }


@dataclass(frozen=True)
class Correlations:
    """How the errors of a plane's figures go together."""

    names: tuple[str, ...]
    matrix: Real
    """(n, n)"""

    def document(self) -> dict[str, Any]:
        """As JSON."""
        return {"names": list(self.names), "matrix": self.matrix.tolist()}


@dataclass(frozen=True)
class Curves:
    """Measured and modelled responses of a plane for the Bode plots (Figures 5.4 to 5.8)."""

    measured: FrequencyResponse
    """u->y"""
    plant: FrequencyResponse
    """Coil current -> y: u->y over the amplifiers' base-band response."""
    amplifier: FrequencyResponse | None
    """u->i, diagonal entries of the plant's points."""
    amplifier_points: tuple[tuple[Real, Complex, Real], tuple[Real, Complex, Real]] | None
    """Per axis (omega, i/u, std) of all points that excite it, the amplifier's own sweep included."""
    validation: FrequencyResponse | None
    """u->y on the unseen sweep."""
    omega: Real
    """Dense grid for the model, rad/s."""
    model: Complex
    """u->y, (F, 2, 2); model_std its standard deviation."""
    model_std: Real
    model_at_lines: Complex
    """u->y at the measured lines and amplitudes."""
    rigid_plant: Complex
    """The staged rigid model on the dense grid."""
    staged_plant: Complex
    """The staged rigid and flexible models stacked, coil current -> y, on the dense grid."""
    validation_model: Complex | None
    """u->y of the model at the lines and amplitudes of the unseen sweep."""


@dataclass(frozen=True)
class Displacement:
    """Displacements that the experiment reached, per point, against the linear range (Figure 5.3)."""

    frequency_hz: Real
    axis: np.ndarray
    amplitude_m: Real
    """(P, 2) at the sensors."""
    linear_range_m: float
    r_a: Real


@dataclass(frozen=True)
class Staged:
    """The thesis's steps one after another, before the joint refinement."""

    split_hz: float
    split_evidence: tuple[Evidence, ...]
    ki: Real
    ks: Real
    rigid_fit_percent: Real
    flexible_fit_percent: Real | None
    complete_fit_percent: Real

    def document(self) -> dict[str, Any]:
        """As JSON."""
        flexible = self.flexible_fit_percent
        return {
            "rigid_fit_percent": self.rigid_fit_percent.tolist(),
            "flexible_fit_percent": None if flexible is None else flexible.tolist(),
            "complete_fit_percent": self.complete_fit_percent.tolist(),
            "split_hz": self.split_hz,
            "split_evidence": [e.document() for e in self.split_evidence],
            "ki_n_per_a": self.ki.tolist(),
            "ks_n_per_m": self.ks.tolist(),
        }
