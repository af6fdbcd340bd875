"""A plane as it is now: the commissioned model, fitted once more to the few tones of a check."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.experiment.data import Experiment
from service.experiment.dead import require_live_channels
from service.health.noise import check_weights
from service.identification.arrays import Real
from service.identification.joint.refine import Refined, refine
from service.identification.joint.residuals import residuals, weights_of
from service.identification.joint.uncertainty import Uncertainty, uncertainty_of
from service.identification.measured.data import Data
from service.identification.measured.points import PlanePoints, check_excitation, plane_points
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Posterior, Split, log_ratios
from service.identification.result.saved import SavedPlane
from sim.errors import AmbError

FEWEST_TONES = 6
ROUNDS = 2
"""Fits, each weighted by the noise under the one before."""
FORGIVING = 0.05
"""Relative model error that the search for moved modes allows for."""
SHIFTS = np.linspace(-0.02, 0.02, 81)
DAMPING = (0.4, 1.0, 2.5)
"""A mode is looked for within 2 % of its frequency and a factor of its damping, and from there by gradients."""


@dataclass(frozen=True)
class PlaneNow:
    """A plane's model after a check."""

    points: PlanePoints
    model: PlaneModel
    refined: Refined
    uncertainty: Uncertainty
    """With the shapes' splits held where the commissioning has them: what is not known of them is common to both."""
    freedom: int
    """Residuals less parameters."""
    rms: float
    """Residuals over their noise."""


def plane_now(saved: SavedPlane, experiment: Experiment) -> PlaneNow:
    """Fit of a check's main sweep.

    Raises
    ------
    AmbError
        Too few usable tones, only one axis excited, or a dead channel.
    """
    if all(s.kind == "noise" for s in experiment.sweeps):
        raise AmbError(f"the check of rig {experiment.rig!r} has no excited tone; run it once more")
    require_live_channels(experiment.main, tuple(experiment.axes), "the check")
    points = plane_points(experiment.main, tuple(experiment.axes), saved.plane)
    check_excitation(points, FEWEST_TONES)
    data = Data(points)
    split = Split(log_ratios(saved.model), beyond=saved.beyond)
    free = saved.free.copy()
    if points.I is None:  # nothing but the currents tells the amplifiers from ki
        free[saved.model.layout.amplifiers[0].start : saved.model.layout.delay] = False
    start = _moved_modes(saved, data)
    near = refine(start, data, free, relative=FORGIVING, split=split)
    refined = near
    for _ in range(ROUNDS):
        weights = check_weights(refined.model, points, experiment)
        refined = refine(refined.model, data, free, split=split, weights=weights)
    n = len(split.log_ratios)
    held = Posterior(split.log_ratios, np.zeros((n, n))) if n else None
    u = uncertainty_of(refined, held)
    rest = refined.fit.residual[: len(refined.fit.residual) - n]
    freedom = max(len(rest) - int(free.sum()) + n, 1)
    return PlaneNow(points, refined.model, refined, u, freedom, float(np.sqrt(rest @ rest / freedom)))


def _moved_modes(saved: SavedPlane, data: Data) -> PlaneModel:
    """Start of the fit: the commissioned model, each mode where its peak is now.

    A mode that moved by many times its half-width leaves the gradient nothing to go by, so it is looked for on a grid.
    """
    model = saved.model
    weights, _ = weights_of(model, data, None, FORGIVING)

    def cost(theta: Real) -> float:
        r, _ = residuals(model.at(theta), data, weights, None, gradient=False)
        return float(np.sum(np.minimum(r**2, 25.0)))

    theta = model.theta.copy()
    for k in saved.rotor_modes:
        at = model.layout.mode(k).start
        best, least = theta, cost(theta)
        for damping in DAMPING:
            for shift in SHIFTS:
                trial = theta.copy()
                trial[at] *= 1 + shift
                trial[at + 1] *= damping
                if (now := cost(trial)) < 0.9 * least:
                    best, least = trial, now
        theta = best
    return model.at(theta)
