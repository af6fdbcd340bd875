"""The commissioning result: what the identification found, as data, and as the JSON of contracts.md section 3."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.loop.closed_loop import Predicted
from service.identification.loop.margins import AxisMargins, margins_document, zone
from service.identification.measured import known
from service.identification.measured.coupling import CrossPlane
from service.identification.measured.etfe import FrequencyResponse
from service.identification.plane.combine import StateSpace
from service.identification.plane.model import PlaneModel
from service.identification.rotating.turned import Turned
from service.identification.statistics.estimate import Estimate as Estimate
from service.identification.statistics.evidence import Evidence
from service.identification.statistics.validation import CorrelationTest
from service.identification.steps.subspace import SubspaceModel
from sim.folded import KnownEffect


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


@dataclass(frozen=True)
class PlaneResult:
    """Everything about one plane."""

    plane: str
    axes: tuple[str, str]
    model: PlaneModel
    covariance: Real
    """Of the free parameters, prior and widening included; order of ``parameter_names``."""
    parameter_names: tuple[str, ...]
    amplifiers: dict[str, AmplifierResult]
    stiffness: dict[str, Estimate]
    modes: tuple[ModeResult, ...]
    delay_s: Estimate
    poles: tuple[RootResult, ...]
    zeros: tuple[RootResult, ...]
    """Transmission zeros, the finite ones."""
    correlations: Correlations
    extended: dict[str, Any]
    fit_percent: Real
    cross_validation_fit_percent: Real | None
    cross_validation_rms: Real | None
    """Residual over noise per entry of y on the unseen sweep."""
    staged: Staged
    residual_rms: Real
    """(outputs, excited axis) rms of residual over noise; outputs i_A, i_B, y_A, y_B or y only."""
    residual_rms_total: float
    tests: dict[str, list[CorrelationTest]]
    tests_passed: bool
    adequate: bool
    """Whether the residuals are of the size of the noise; if not, every std is widened."""
    widening: float
    """Largest factor by which a std was widened."""
    mode_evidence: tuple[Evidence, ...]
    state_space: StateSpace
    amplifier_state_space: StateSpace
    margins: dict[str, AxisMargins]
    zones_db: tuple[tuple[str, float], ...]
    """Zones by peak sensitivity: the datasheet's."""
    curves: Curves
    displacement: Displacement
    subspace: SubspaceModel
    """Black-box model of the same order from coil current to y, for comparison (Table 5-6)."""
    status: str
    warnings: tuple[str, ...] = ()
    covariance_from_data: Real | None = None
    """The part of ``covariance`` that noise brings, the shapes' splits held."""
    closed_loop: Predicted | None = None
    """Predicted against measured closed loop, on the unseen sweep where there is one."""

    @property
    def worst_peak(self) -> float:
        """The largest sensitivity of the plane, of the model and measured."""
        return max(max(m.sensitivity_peak, m.measured_peak or 0.0) for m in self.margins.values())

    def zone(self, peak: float) -> str:
        """Zone of a peak sensitivity, not in dB."""
        return zone(peak, self.zones_db)

    def document(self) -> dict[str, Any]:
        """As JSON, contracts.md section 3."""
        return {
            "amplifiers": {
                axis: {
                    "order": a.order,
                    "poles_rad_s": _complex(a.poles),
                    "dc_gain": a.dc_gain,
                    "fit_percent": a.fit_percent,
                    "first_order_fit_percent": a.first_order_fit_percent,
                    "parameters": {k: v.document() for k, v in a.parameters.items()},
                    "evidence": [evidence_document(e) for e in a.evidence],
                }
                for axis, a in self.amplifiers.items()
            },
            "delay_s": self.delay_s.document(),
            "stiffness": {k: v.document() for k, v in self.stiffness.items()},
            "rotor_modes": [_mode(m) for m in self.modes if m.kind == "rotor"],
            "other_modes": [_mode(m) for m in self.modes if m.kind != "rotor"],
            "mode_evidence": [evidence_document(e) for e in self.mode_evidence],
            "plant_poles": [p.document() for p in self.poles],
            "plant_zeros": [z.document() for z in self.zeros],
            "correlations": self.correlations.document(),
            "extended": self.extended,
            "fit_percent": self.fit_percent.tolist(),
            "cross_validation_fit_percent": _matrix(self.cross_validation_fit_percent),
            "cross_validation_rms": _matrix(self.cross_validation_rms),
            "staged": {
                "rigid_fit_percent": self.staged.rigid_fit_percent.tolist(),
                "flexible_fit_percent": _matrix(self.staged.flexible_fit_percent),
                "complete_fit_percent": self.staged.complete_fit_percent.tolist(),
                "split_hz": self.staged.split_hz,
                "split_evidence": [evidence_document(e) for e in self.staged.split_evidence],
                "ki_n_per_a": self.staged.ki.tolist(),
                "ks_n_per_m": self.staged.ks.tolist(),
            },
            "residuals": {
                "whiteness": {t.name: t.document() for t in self.tests["whiteness"]},
                "independence": {t.name: t.document() for t in self.tests["independence"]},
                "level": 0.99,
                "passed": self.tests_passed,
                "rms_over_sigma": self.residual_rms_total,
                "rms_over_sigma_by_entry": self.residual_rms.tolist(),
                "model_adequate": self.adequate,
                "std_widened_by": self.widening,
            },
            "state_space": self.state_space.document(),
            "amplifier_state_space": self.amplifier_state_space.document(),
            "margins": {
                **margins_document(self.margins),
                "iso_14839_3_zone": self.zone(self.worst_peak),
                "zone_limits_db": dict(self.zones_db[:-1]),
                "closed_loop_fit_percent": {
                    "r_to_u": _matrix(None if self.closed_loop is None else self.closed_loop.u_percent),
                    "r_to_y": _matrix(None if self.closed_loop is None else self.closed_loop.y_percent),
                },
            },
            "subspace": {
                "order": self.subspace.order,
                "fit_percent": self.subspace.fit_percent.tolist(),
                "poles_rad_s": _complex(self.subspace.poles),
            },
            "parameters": {
                "amplifier_orders": list(self.model.layout.amplifier_orders),
                "modes": self.model.layout.n_modes,
                "values": dict(zip(self.model.layout.names, self.model.theta.tolist(), strict=True)),
                "free": list(self.parameter_names),
                "covariance": self.covariance.tolist(),
                "covariance_from_data": _matrix(self.covariance_from_data),
            },
            "status": self.status,
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class CommissioningResult:
    """Result of identifying a whole rig."""

    rig: str
    axes: tuple[str, ...]
    planes: dict[str, PlaneResult]
    main_sweep: str
    validation_sweep: str | None
    speed_rad_s: float = 0.0
    """Of the rotor while the planes were measured."""
    warnings: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    rotating: Turned | None = None
    """The rotor over all speeds, of an experiment at speed."""
    cross_planes: tuple[CrossPlane, ...] = ()
    """What of each plane's excitation the other one shows, at standstill."""
    known_effects: tuple[KnownEffect, ...] = ()
    """Effects that the twin named, and where the model has them."""

    def document(self, experiment: str = "experiment.h5") -> dict[str, Any]:
        """The contents of result.json; every number in it is finite or null."""
        document = {
            "format": "amb-commissioning-result",
            "version": 1,
            "rig": self.rig,
            "planes": {name: p.document() for name, p in self.planes.items()},
            "experiment": experiment,
            "speed_rad_s": self.speed_rad_s,
            "warnings": list(self.warnings),
            "provenance": {
                "main_sweep": self.main_sweep,
                "validation_sweep": self.validation_sweep,
                **self.provenance,
            },
        }
        if self.known_effects:
            document[known.ENTRY] = known.document(self.known_effects)
        if self.cross_planes:
            document["cross_planes"] = [c.document() for c in self.cross_planes]
        if self.rotating is not None:
            document["rotating"] = self.rotating.document()
        return {k: _finite(v) for k, v in document.items()}


def evidence_document(e: Evidence) -> dict[str, Any]:
    """Scores of one candidate as JSON."""
    return {
        "name": e.name,
        "parameters": e.n_parameters,
        "data": e.n_data,
        "cost": e.cost,
        "rms_over_sigma": e.rms,
        "aic": e.aic,
        "mdl": e.mdl,
        "fpe": e.fpe,
        "leave_one_out_rms": e.leave_one_out_rms,
        "cross_validation_rms": e.unseen_rms,
        "chosen": e.chosen,
        "note": e.note,
    }


def _mode(m: ModeResult) -> dict[str, Any]:
    return {
        "natural_frequency_rad_s": m.natural_frequency_rad_s.document(),
        "damping_ratio": m.damping_ratio.document(),
        "levitated_frequency_rad_s": m.levitated_frequency_rad_s.document(),
        "shape_at_bearings": [e.document() for e in m.shape_at_bearings],
        "shape_at_sensors": [e.document() for e in m.shape_at_sensors],
        "kind": m.kind,
    }


def _complex(values: Complex) -> list[list[float]]:
    return [[float(v.real), float(v.imag)] for v in values]


def _matrix(values: Real | None) -> list[list[float]] | None:
    return None if values is None else values.tolist()


def _finite(value: Any) -> Any:
    """The same document with null for what is not finite and plain Python numbers for numpy's."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
