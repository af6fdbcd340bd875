"""How a plane's model does on the points that it was fitted to, and on those that no fit has seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.distributions import chi2_above
from service.identification.arrays import Complex, Real
from service.identification.joint.refine import FAR, NEAR, Refined, amplitude_of
from service.identification.joint.residuals import noise_of
from service.identification.joint.selection import Selected
from service.identification.joint.uncertainty import Uncertainty
from service.identification.measured.etfe import FrequencyResponse, etfe
from service.identification.measured.points import PlanePoints, same_frequency
from service.identification.plane.model import PlaneModel
from service.identification.plane.prediction import Amplitude, Points
from service.identification.statistics.evidence import Evidence
from service.identification.statistics.validation import CorrelationTest, independence, nrmse_matrix, whiteness
from service.identification.steps.staged import StagedFit

UNSEEN = 2.0
"""Residual on points that no fit has seen, in units of what noise and the model's deviations make of it, beyond which
the model does not hold there: its deviations are then less than half of its errors."""
LEVEL = 0.001
"""Of the chance that noise alone makes such a residual."""


def frequency_fit(model: PlaneModel, points: PlanePoints, amplitude: Amplitude | None) -> tuple[Real, Complex]:
    """NRMSE of u->y per entry at the measured amplitudes, and the model's response there, (F, 2, 2)."""
    measured = etfe(points, "u->y")
    y = model.predict(Points(points.omega, points.u), amplitude).y
    groups = [g for g in same_frequency(points.omega) if len(np.unique(points.axis[g])) == 2]
    response = np.stack([y[g].T @ np.linalg.pinv(points.u[g].T) for g in groups])
    return nrmse_matrix(measured.value, response), response


def cross_validation(
    model: PlaneModel, points: PlanePoints | None, reach: float = FAR
) -> tuple[Real | None, Real | None, FrequencyResponse | None, Complex | None]:
    """Fit and rms/sigma on points that no step of the fit has seen, the response there, measured and of the model.

    ``reach``: that of `joint.refine.amplitude_of`.
    """
    if points is None:
        return None, None, None, None
    groups = [g for g in same_frequency(points.omega) if len(np.unique(points.axis[g])) == 2]
    amplitude = amplitude_of(model, points, reach)
    y = model.predict(Points(points.omega, points.u), amplitude).y
    sigma = noise_of(model, points, amplitude).sigma[:, -2:]
    e = np.abs(points.y - y) / sigma
    rms = np.full((2, 2), np.nan)
    for k in range(2):
        if np.any(points.axis == k):
            rms[:, k] = np.sqrt(np.mean(e[points.axis == k] ** 2, axis=0))
    if len(groups) < 3:
        return None, rms, None, None
    fit, response = frequency_fit(model, points, amplitude)
    return fit, rms, etfe(points, "u->y"), response


def off_unseen(model: PlaneModel, u: Uncertainty, points: PlanePoints | None, reach: float = FAR) -> float:
    """Largest rms/sigma of an entry on points that no fit has seen, of those that the model cannot account for; or 0.

    Those are `UNSEEN` times as large as noise and the standard deviations of the model make them, and more than chance
    does. ``reach``: that of `joint.refine.amplitude_of`.
    """
    if points is None:
        return 0.0
    amplitude, at = amplitude_of(model, points, reach), Points(points.omega, points.u)

    def flat(m: PlaneModel) -> Real:
        return np.ascontiguousarray(m.predict(at, amplitude).y).view(np.float64).ravel()

    noise = noise_of(model, points, amplitude)
    power = noise.sigma[:, -2:] ** 2
    off = np.abs(points.y - model.predict(at, amplitude).y) ** 2
    allowed = power + np.sum(u.std(model, flat)[0].reshape(*points.y.shape, 2) ** 2, axis=2)
    largest = 0.0
    for rows in (points.axis == k for k in np.unique(points.axis)):
        ratio = np.mean(off[rows] / allowed[rows], axis=0)
        chance = noise.inflation * chi2_above(LEVEL, 2 * int(rows.sum())) / (2 * rows.sum())
        for c in np.flatnonzero(ratio > max(UNSEEN**2, chance)):
            largest = max(largest, float(np.sqrt(np.mean(off[rows, c] / power[rows, c]))))
    return largest


def residual_tests(refined: Refined, points: PlanePoints) -> tuple[Real, dict[str, list[CorrelationTest]]]:
    """rms/sigma per channel and excited axis, and the correlation tests of the displacement's residuals."""
    p = refined.model.predict(Points(points.omega, points.u), refined.amplitude)
    sigma = refined.noise.sigma
    e, shown = np.asarray((points.y - p.y) / sigma[:, -2:], dtype=np.complex128), p.y
    channels = [f"y_{a}" for a in points.axes]
    if points.i is not None:
        e, shown = np.hstack([(points.i - p.i) / sigma[:, :2], e]), np.hstack([p.i, p.y])
        channels = [f"i_{a}" for a in points.axes] + channels
    rms = np.array(
        [[np.sqrt(np.mean(np.abs(e[points.axis == k, c]) ** 2)) for k in range(2)] for c in range(e.shape[1])]
    )
    tests: dict[str, list[CorrelationTest]] = {"whiteness": [], "independence": []}
    for c in range(e.shape[1] - 2, e.shape[1]):
        for k in range(2):
            rows = points.axis == k
            name = f"{channels[c]} from {points.axes[k]}"
            tests["whiteness"].append(whiteness(name, e[rows, c]))
            tests["independence"].append(independence(name, e[rows, c], shown[rows, c]))
    return rms, tests


def total_rms(of_entries: Real) -> float:
    """Residual over noise of all entries together."""
    return float(np.sqrt(np.mean(of_entries**2)))


def unseen_modes(selected: Selected, points: PlanePoints | None) -> tuple[Evidence, ...]:
    """The evidence on the number of modes, with how each candidate does on points that no fit has seen."""
    if points is None:
        return selected.evidence
    # one noise for all of them: that of the chosen model
    chosen = selected.refined.model
    sigma = noise_of(chosen, points, amplitude_of(chosen, points, NEAR)).sigma[:, -2:]
    out = []
    for e, model in zip(selected.evidence, selected.candidates, strict=True):
        y = model.predict(Points(points.omega, points.u), amplitude_of(model, points, NEAR)).y
        out.append(replace(e, unseen_rms=float(np.sqrt(np.mean(np.abs((points.y - y) / sigma) ** 2)))))
    return tuple(out)


def unseen_splits(staged: StagedFit, points: PlanePoints | None) -> tuple[Evidence, ...]:
    """The evidence on the split, with how each does on points that no fit has seen, in units of their noise."""
    if points is None:
        return staged.split_evidence
    model = staged.rigid_model
    sigma = noise_of(model, points, None).sigma[:, -2:]
    current = model.amplifier_response(points.omega) * points.u
    out = []
    for e, stacked in zip(staged.split_evidence, staged.splits, strict=True):
        y = np.einsum("pab,pb->pa", stacked.response(model, points.omega), current)
        out.append(replace(e, unseen_rms=float(np.sqrt(np.mean(np.abs((points.y - y) / sigma) ** 2)))))
    return tuple(out)
