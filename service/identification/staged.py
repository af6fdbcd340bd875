"""The thesis's steps one after another: rigid below the split, flexible above, stacked. Starts, and a comparison."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.identification.etfe import FrequencyResponse
from service.identification.flexible import PoleResidue, search, split_frequency
from service.identification.plane_model import PlaneModel
from service.identification.points import PlanePoints
from service.identification.rigid import rigid_refined, rigid_response, rigid_start
from service.identification.selection import coarse_number
from service.identification.validation import nrmse_matrix
from service.identification.zoh import Complex, Real

SEARCH_MODES = 5
RIGID_GOOD_PERCENT = 90.0


@dataclass(frozen=True)
class StagedFit:
    """What the steps give before anything is refined jointly."""

    rigid_model: PlaneModel
    """The plane with the staged ki and ks, no modes."""
    split_rad_s: float
    split_evidence: tuple[dict[str, float], ...]
    search: list[PoleResidue]
    """Pole-residue models with 1, 2, ... modes for what the rigid model leaves."""
    n_modes: int
    lowest_mode_rad_s: float
    rigid_fit_percent: Real
    flexible_fit_percent: Real | None
    complete_fit_percent: Real

    @property
    def flexible(self) -> PoleResidue | None:
        """The flexible model with the chosen number of modes."""
        return self.search[self.n_modes - 1] if self.n_modes else None

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
    left = plant.value - rigid_response(model, ki, ks, plant.omega)
    weight = np.broadcast_to((1 / np.linalg.norm(plant.value, axis=(1, 2)))[:, None, None], left.shape).copy()
    models = search(plant.omega, left, weight, SEARCH_MODES, 0.6 * first, enough=0.005)
    n_modes, _ = coarse_number(models, FrequencyResponse(plant.omega, left, plant.std), weight, 0.03)
    result = StagedFit(
        rigid_model, limit, tuple(evidence), models, n_modes, 0.6 * first, fit, None, np.full((2, 2), np.nan)
    )
    flexible_fit = None
    above = plant.omega >= limit
    if n_modes and above.sum() > 3:
        assert result.flexible is not None
        flexible_fit = nrmse_matrix(left[above], result.flexible.response(plant.omega[above]))
    return StagedFit(
        rigid_model,
        limit,
        tuple(evidence),
        models,
        n_modes,
        0.6 * first,
        fit,
        flexible_fit,
        nrmse_matrix(plant.value, result.response(plant.omega)),
    )


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
