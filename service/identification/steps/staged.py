"""The thesis's steps one after another: rigid below the split, flexible above, stacked. Starts, and a comparison."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.identification.arrays import Complex, Real
from service.identification.measured.etfe import FrequencyResponse
from service.identification.measured.points import PlanePoints
from service.identification.plane.model import PlaneModel
from service.identification.statistics.evidence import Evidence
from service.identification.statistics.validation import nrmse_matrix
from service.identification.steps.flexible import PoleResidue, residues_at, split_frequency
from service.identification.steps.rational import LEVEL, Rational, rational_fit
from service.identification.steps.rigid import levitated, rigid_refined, rigid_response, rigid_start

RIGID_GOOD_PERCENT = 90.0
SPLITS, FEWEST = (0.4, 0.6, 0.8, 1.0, 1.2, 1.4), 4
"""Splits to try, in units of where the first mode's foot lies, and the lines below one that a rigid fit needs."""


@dataclass(frozen=True)
class Stacked:
    """Rigid rotor below a split, modes for what it leaves, both stacked."""

    limit_rad_s: float
    ki: Real
    ks: Real
    flexible: PoleResidue | None

    def rigid_response(self, model: PlaneModel, omega: Real) -> Complex:
        """Coil current to y, (F, 2, 2)."""
        return rigid_response(model, self.ki, self.ks, omega)

    def response(self, model: PlaneModel, omega: Real) -> Complex:
        """The same of both."""
        rigid = self.rigid_response(model, omega)
        return rigid if self.flexible is None else rigid + self.flexible.response(omega)


@dataclass(frozen=True)
class StagedFit:
    """What the steps give before anything is refined jointly."""

    rigid_model: PlaneModel
    """The plane with the staged ki and ks, no modes."""
    best: Stacked
    splits: tuple[Stacked, ...]
    """Every split that was tried, and ``split_evidence`` its scores."""
    split_evidence: tuple[Evidence, ...]
    rational: Rational
    """Poles of the measured plant, which tell of the modes in the band."""
    lowest_mode_rad_s: float
    rigid_fit_percent: Real
    flexible_fit_percent: Real | None
    complete_fit_percent: Real

    @property
    def split_rad_s(self) -> float:
        """The split that was chosen."""
        return self.best.limit_rad_s

    @property
    def flexible(self) -> PoleResidue | None:
        """The flexible model: the measured plant's poles, with the residues of what the staged rigid model leaves."""
        return self.best.flexible

    def response(self, omega: Real) -> Complex:
        """Rigid and flexible models stacked, coil current to y, (F, 2, 2)."""
        return self.best.response(self.rigid_model, omega)


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
    limits = [first * f for f in SPLITS if np.sum(plant.omega < first * f) >= FEWEST]
    if not limits:
        limits = [float(plant.omega[min(len(plant.omega) - 1, max(4, len(plant.omega) // 2))] * 1.001)]
    rigid = [(limit, *_rigid(model, points, limit)) for limit in limits]
    # the highest split at which the rigid rotor still describes the octave below it: where the poles are looked for
    good = [k for k, r in enumerate(rigid) if _local_misfit(model, *r[1:], plant, r[0]) < 100.0 - RIGID_GOOD_PERCENT]
    rational = rational_fit(plant, levitated(model, rigid[good[-1] if good else 0][2]), 0.6 * first)
    stacks = [_stacked(model, plant, rational.peaks, *r) for r in rigid]
    scores = [_score(model, plant, s) for s in stacks]
    pick = int(np.argmin([e.mdl for e in scores]))
    scores = [replace(e, chosen=k == pick) for k, e in enumerate(scores)]
    best = stacks[pick]
    low, above = plant.omega < best.limit_rad_s, plant.omega >= best.limit_rad_s
    theta = model.theta.copy()
    theta[0:2], theta[2:4] = best.ki, best.ks
    rigid_fit = np.full((2, 2), np.nan)
    if low.sum() >= FEWEST:
        rigid_fit = nrmse_matrix(plant.value[low], best.rigid_response(model, plant.omega[low]))
    flexible_fit = None
    if best.flexible is not None and above.sum() > 3:
        left = plant.value[above] - best.rigid_response(model, plant.omega[above])
        flexible_fit = nrmse_matrix(left, best.flexible.response(plant.omega[above]))
    complete_fit = nrmse_matrix(plant.value, best.response(model, plant.omega))
    return StagedFit(
        model.at(theta),
        best,
        tuple(stacks),
        tuple(scores),
        rational,
        0.6 * first,
        rigid_fit,
        flexible_fit,
        complete_fit,
    )


def _stacked(
    model: PlaneModel, plant: FrequencyResponse, peaks: PoleResidue, limit: float, ki: Real, ks: Real
) -> Stacked:
    flexible = None
    if peaks.n_modes:
        left = plant.value - rigid_response(model, ki, ks, plant.omega)
        weight = 1 / np.linalg.norm(plant.value, axis=(1, 2))
        flexible = residues_at(plant.omega, left, weight, peaks.nu_rad_s, peaks.sigma_rad_s)
    return Stacked(limit, ki, ks, flexible)


def _score(model: PlaneModel, plant: FrequencyResponse, stacked: Stacked) -> Evidence:
    """Scores over the whole band; what the steps cannot have counts beside the noise."""
    e = plant.value - stacked.response(model, plant.omega)
    size = np.linalg.norm(plant.value, axis=(1, 2))[:, None, None] / 2
    variance = plant.std**2 + (LEVEL * size) ** 2
    n = 0 if stacked.flexible is None else stacked.flexible.n_modes
    cost = float(np.sum(2 * np.abs(e) ** 2 / variance))
    return Evidence(f"split at {stacked.limit_rad_s / (2 * np.pi):.0f} Hz", 4 + 10 * n, 2 * e.size, cost)


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
