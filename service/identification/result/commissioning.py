"""The commissioning result: what the identification found, as data, and as the JSON of contracts.md section 3."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from service.identification.arrays import Real
from service.identification.loop.margins import AxisMargins, margins_document, zone
from service.identification.loop.predicted import Predicted
from service.identification.measured import known
from service.identification.measured.coupling import CrossPlane
from service.identification.plane.combine import StateSpace
from service.identification.plane.model import PlaneModel
from service.identification.priors.given import Adjusted
from service.identification.result.parts import (
    AmplifierResult,
    Correlations,
    Curves,
    Displacement,
    ModeResult,
    RootResult,
    Staged,
)
from service.identification.rotating.turned import Turned
from service.identification.statistics.estimate import Estimate
from service.identification.statistics.evidence import Evidence
from service.identification.statistics.validation import CorrelationTest
from service.identification.steps.subspace import SubspaceModel
from sim.datasheet import NOT_KNOWN
from sim.folded import KnownEffect

NOTHING_PERCENT = -100.0
"""NRMSE below which a model leaves twice what was measured: noise alone, as near instability, leaves no more."""
UNKNOWN = 1.0
"""Relative standard deviation of a stiffness from which nothing is known of it."""


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
    beyond_measured: str = ""
    """Why its sensitivity peak is not known, as it lies above the measured band, in words; "" where it is."""
    off_unseen: float = 0.0
    """Residual over noise of the worst entry on the unseen sweep, where the standard deviations do not allow for it; 0
    where the model holds there, or where there is no such sweep."""
    closed_loop: Predicted | None = None
    """Predicted against measured closed loop, on the unseen sweep where there is one."""

    @property
    def worst_peak(self) -> float:
        """The largest sensitivity of the plane: the model's, or one that was measured and is larger beyond doubt."""
        return max(m.worst for m in self.margins.values())

    @property
    def measured_hz(self) -> tuple[float, float]:
        """The lowest and the highest line that it was identified from."""
        lines = self.displacement.frequency_hz
        return float(lines.min()), float(lines.max())

    def zone(self, peak: float) -> str:
        """Zone of a peak sensitivity, not in dB; not known where that lies above the measured band."""
        return NOT_KNOWN if self.beyond_measured else zone(peak, self.zones_db)

    def document(self) -> dict[str, Any]:
        """As JSON, contracts.md section 3."""
        return {
            "amplifiers": {axis: a.document() for axis, a in self.amplifiers.items()},
            "delay_s": self.delay_s.document(),
            "stiffness": {k: v.document() for k, v in self.stiffness.items()},
            "rotor_modes": [m.document() for m in self.modes if m.kind == "rotor"],
            "other_modes": [m.document() for m in self.modes if m.kind != "rotor"],
            "mode_evidence": [e.document() for e in self.mode_evidence],
            "plant_poles": [p.document() for p in self.poles],
            "plant_zeros": [z.document() for z in self.zeros],
            "correlations": self.correlations.document(),
            "extended": self.extended,
            "fit_percent": self.fit_percent.tolist(),
            "cross_validation_fit_percent": _matrix(self.cross_validation_fit_percent),
            "cross_validation_rms": _matrix(self.cross_validation_rms),
            "cross_validation_passed": None if self.cross_validation_rms is None else self.off_unseen == 0,
            "staged": self.staged.document(),
            "residuals": self._residuals(),
            "state_space": self.state_space.document(),
            "amplifier_state_space": self.amplifier_state_space.document(),
            "margins": self._margins(),
            "measured_hz": list(self.measured_hz),
            "subspace": self.subspace.document(),
            "parameters": self._parameters(),
            "status": self.status,
            "warnings": list(self.warnings),
        }

    def _residuals(self) -> dict[str, Any]:
        return {
            "whiteness": {t.name: t.document() for t in self.tests["whiteness"]},
            "independence": {t.name: t.document() for t in self.tests["independence"]},
            "level": 0.99,
            "passed": self.tests_passed,
            "rms_over_sigma": self.residual_rms_total,
            "rms_over_sigma_by_entry": self.residual_rms.tolist(),
            "model_adequate": self.adequate,
            "std_widened_by": self.widening,
        }

    def _margins(self) -> dict[str, Any]:
        return {
            **margins_document(self.margins),
            "iso_14839_3_zone": self.zone(self.worst_peak),
            "zone_limits_db": dict(self.zones_db[:-1]),
            "closed_loop_fit_percent": {
                "r_to_u": _matrix(None if self.closed_loop is None else self.closed_loop.u_percent),
                "r_to_y": _matrix(None if self.closed_loop is None else self.closed_loop.y_percent),
            },
        }

    def _parameters(self) -> dict[str, Any]:
        return {
            "amplifier_orders": list(self.model.layout.amplifier_orders),
            "modes": self.model.layout.n_modes,
            "values": dict(zip(self.model.layout.names, self.model.theta.tolist(), strict=True)),
            "free": list(self.parameter_names),
            "covariance": self.covariance.tolist(),
            "covariance_from_data": _matrix(self.covariance_from_data),
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
    adjusted: tuple[Adjusted, ...] = ()
    """Values that were held in place of the datasheet's, where those did not explain the data and these do."""
    controller_differs: bool = False
    """Whether the log is not of the datasheet's controller, of which all margins are."""

    @property
    def unseen(self) -> bool:
        """Whether every plane was checked with a sweep that no fit has seen."""
        return all(p.cross_validation_fit_percent is not None for p in self.planes.values())

    @property
    def worst_fit_percent(self) -> float:
        """NRMSE in the worst entry of any plane, on the unseen sweep where every plane has one."""
        planes = self.planes.values()
        unseen = [f for p in planes if (f := p.cross_validation_fit_percent) is not None]
        return min(float(np.min(f)) for f in (unseen if self.unseen else [p.fit_percent for p in planes]))

    @property
    def stiffness_uncertainty(self) -> float:
        """Relative standard deviation of the stiffness that is known worst."""
        every = [e for p in self.planes.values() for e in p.stiffness.values()]
        return max(e.std / abs(e.value) if e.value else math.inf for e in every)

    @property
    def identified(self) -> bool:
        """Whether the figures say anything: nobody may build on those of a model that does not."""
        return self.worst_fit_percent >= NOTHING_PERCENT and self.stiffness_uncertainty < UNKNOWN

    def document(self, experiment: str = "experiment.h5") -> dict[str, Any]:
        """The contents of result.json; every number in it is finite or null."""
        document = {
            "format": "amb-commissioning-result",
            "version": 1,
            "rig": self.rig,
            "identified": self.identified,
            "controller_as_stated": not self.controller_differs,
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
        if self.adjusted:
            document["adjusted"] = [a.document() for a in self.adjusted]
        if self.cross_planes:
            document["cross_planes"] = [c.document() for c in self.cross_planes]
        if self.rotating is not None:
            document["rotating"] = self.rotating.document()
        return {k: _finite(v) for k, v in document.items()}


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
