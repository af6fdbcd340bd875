"""The thesis's steps one after another: rigid below the split, flexible above, stacked. Starts, and a comparison."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.identification.etfe import FrequencyResponse
from service.identification.flexible import PoleResidue, residues_at, split_frequency
from service.identification.plane_model import PlaneModel
from service.identification.points import PlanePoints
from service.identification.rational import Rational, rational_fit
from service.identification.rigid import rigid_refined, rigid_response, rigid_start
from service.identification.validation import nrmse_matrix
from service.identification.zoh import Complex, Real

RIGID_GOOD_PERCENT = 90.0


@dataclass(frozen=True)
class StagedFit:
    """What the steps give before anything is refined jointly."""

    rigid_model: PlaneModel
    """The plane with the staged ki and ks, no modes."""
    split_rad_s: float
    split_evidence: tuple[dict[str, float], ...]
    rational: Rational
    """Poles of the measured plant, which tell of the modes in the band."""
    flexible: PoleResidue | None
    """The flexible model: those poles, with the residues of what the staged rigid model leaves."""
    lowest_mode_rad_s: float
    rigid_fit_percent: Real
    flexible_fit_percent: Real | None
    complete_fit_percent: Real

    def response(self, omega: Real) -> Complex:
        """Rigid and flexible models stacked, coil current to y, (F, 2, 2)."""
        rigid = rigid_response(self.rigid_model, self.rigid_model.ki, self.rigid_model.ks, omega)
        return rigid if self.flexible is None else rigid + self.flexible.response(omega)


def staged_fit(model: PlaneModel, points: PlanePoints, plant: FrequencyResponse) -> StagedFit:
    """Steps 4 to 6: rigid rotor below the split, modes for what is left, both stacked.

    Parameters
    ----------
    model
        Amplifiers fitted, no modes.
    plant
        Measured plant from coil current to y.
    """
    first = split_frequency(plant.omega, plant.value)
    candidates = [first * f for f in (0.4, 0.6, 0.8, 1.0, 1.2, 1.4)]
    evidence, fits = [], []
    for limit in candidates:
        low = plant.omega < limit
        if low.sum() < 4:
            continue
        ki, ks = _rigid(model, points, limit)
        fit = nrmse_matrix(plant.value[low], rigid_response(model, ki, ks, plant.omega[low]))
        evidence.append(
            {
                "split_hz": limit / (2 * np.pi),
                "lines": float(low.sum()),
                "worst_diagonal_fit_percent": float(min(fit[0, 0], fit[1, 1])),
                "worst_fit_percent": float(fit.min()),
                "local_misfit_percent": _local_misfit(model, ki, ks, plant, limit),
            }
        )
        fits.append((limit, ki, ks, fit))
    if not fits:
        limit = float(plant.omega[min(len(plant.omega) - 1, max(4, len(plant.omega) // 2))] * 1.001)
        ki, ks = _rigid(model, points, limit)
        fits = [(limit, ki, ks, np.full((2, 2), np.nan))]
        evidence = [{"split_hz": limit / (2 * np.pi)}]
    # the highest split at which the rigid rotor still describes the octave below it
    good = [k for k, e in enumerate(evidence) if e.get("local_misfit_percent", 0.0) < 100.0 - RIGID_GOOD_PERCENT]
    pick = good[-1] if good else 0
    for k, e in enumerate(evidence):
        e["chosen"] = float(k == pick)
    limit, ki, ks, fit = fits[pick]

    theta = model.theta.copy()
    theta[0:2], theta[2:4] = ki, ks
    rigid_model = model.at(theta)
    bearings, _ = model.rigid_shapes
    levitated = np.sqrt(np.maximum(np.linalg.eigvalsh(bearings.T @ (ks[:, None] * bearings)), 1.0))
    rational = rational_fit(plant, levitated, 0.6 * first)
    peaks, flexible = rational.peaks, None
    left = plant.value - rigid_response(model, ki, ks, plant.omega)
    if peaks.n_modes:
        weight = 1 / np.linalg.norm(plant.value, axis=(1, 2))
        flexible = residues_at(plant.omega, left, weight, peaks.nu_rad_s, peaks.sigma_rad_s)
    above = plant.omega >= limit
    flexible_fit = None
    if flexible is not None and above.sum() > 3:
        flexible_fit = nrmse_matrix(left[above], flexible.response(plant.omega[above]))
    result = StagedFit(
        rigid_model, limit, tuple(evidence), rational, flexible, 0.6 * first, fit, flexible_fit, np.full((2, 2), np.nan)
    )
    return replace(result, complete_fit_percent=nrmse_matrix(plant.value, result.response(plant.omega)))


def _rigid(model: PlaneModel, points: PlanePoints, limit: float) -> tuple[Real, Real]:
    low = points.omega < limit
    current = model.amplifier_response(points.omega[low]) * points.u[low]
    y = points.y[low]
    ki, ks = rigid_start(model, points.omega[low], current, y)
    # constant relative accuracy, as the amplitude profile of eq. 3.18 gives it
    size = np.broadcast_to(np.linalg.norm(y, axis=1, keepdims=True), y.shape)
    return rigid_refined(model, ki, ks, points.omega[low], current, y, np.asarray(size))


def _local_misfit(model: PlaneModel, ki: Real, ks: Real, plant: FrequencyResponse, limit: float) -> float:
    """Relative misfit of the rigid model in the octave below the limit, percent."""
    octave = (plant.omega >= 0.5 * limit) & (plant.omega < limit)
    if not octave.any():
        return 0.0
    e = plant.value[octave] - rigid_response(model, ki, ks, plant.omega[octave])
    return 100.0 * float(np.median(np.linalg.norm(e, axis=(1, 2)) / np.linalg.norm(plant.value[octave], axis=(1, 2))))
