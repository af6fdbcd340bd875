"""A characteristic that is curved, c2 x^2 + c3 x^3 + .., fitted to a part of the loop as an effect would be.

No law of the catalogue bends the characteristic of a sensor, or of an amplifier but at its voltage limit, nor has it a
force at the bearings that grows smoothly; effects that bend a force make harmonics too, and change the answer with the
amplitude, so they may stand for one. All of it is linear in the curvatures, and so are small changes of the datasheet's
values beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fit import Problem
from service.gap.fitting.jacobian import stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import weight
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.measured.observation import Observation
from service.gap.which.curved_laws import POWERS, CurvedLaw, curved_laws
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

NOTHING = 1e-12
"""Share of the largest eigenvalue below which data tell nothing of a direction."""
CHI_SQUARE_SHOWN = 36.0
"""Chi-square that the next power takes off where it is there; else it would only blur what is known of the third."""


@dataclass(frozen=True)
class Curvature:
    """A part's curved characteristic, the datasheet's values fitted beside it."""

    ground: Ground
    null: Candidate
    """the plain twin"""
    law: CurvedLaw
    powers: tuple[int, ...]
    solution: Real
    """changes of the plain twin's values, then curvatures, (a + powers * n,)"""
    deviation: Real
    """standard deviation of each, (a + powers * n,); infinite where no signal tells it"""
    explained: float
    """of the plain twin's cost on the fitted sweeps"""

    @property
    def value(self) -> Real:
        """Curvatures of `POWERS`, (powers, n), 1/m, 1/A and their squares."""
        return self._curvatures(self.solution)

    @property
    def std(self) -> Real:
        """Their standard deviations, (powers, n)."""
        return self._curvatures(self.deviation)

    def explained_on(self, o: Observation, plain: Complex) -> float:
        """Chi-square that it takes off a sweep no fit has seen; ``plain`` is what the plain twin leaves, (P, H, n)."""
        rows, left, *_ = _system(self.ground, self.null, [(o, plain)], self.law, self.powers)
        return float(left @ left - np.sum((left - rows @ self.solution) ** 2))

    def _curvatures(self, x: Real) -> Real:
        n = self.ground.nuisance.rig.n_axes
        return x[len(x) - len(self.powers) * n :].reshape(len(self.powers), n)[: len(POWERS)]


def curvatures(ground: Ground, null: Candidate, plain: Sequence[Complex]) -> list[Curvature]:
    """What each curved characteristic of a part explains of what the plain twin leaves, (P, H, n) per sweep.

    A higher power is there only where it shows.
    """
    out = []
    for law in curved_laws(ground.part):
        best, *others = (_fitted(ground, null, plain, law, powers) for powers in law.powers)
        for more in others:
            best = more if more.explained > best.explained + CHI_SQUARE_SHOWN else best
        out.append(best)
    return out


def _fitted(
    ground: Ground, null: Candidate, plain: Sequence[Complex], law: CurvedLaw, powers: tuple[int, ...]
) -> Curvature:
    sweeps = list(zip(ground.observations, plain, strict=True))
    rows, left, prior, pull = _system(ground, null, sweeps, law, powers)
    hessian = rows.T @ rows + prior
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))  # a curvature is per m^2, a deviation per tolerance
    inverse = np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    gradient = rows.T @ left + pull
    # To first order a value could make up for anything, many tolerances away.
    now = null.fit.theta[ground.part.active]
    low, high = (np.full(len(scale), far) for far in (-np.inf, np.inf))
    low[: len(now)], high[: len(now)] = -TOLERANCE_BOUND - now, TOLERANCE_BOUND - now
    x = _within(hessian / np.outer(scale, scale), gradient / scale, low * scale, high * scale) / scale
    variance = np.diag(inverse)
    std = np.where(variance > 0, np.sqrt(np.maximum(variance, 0)), np.inf)
    return Curvature(ground, null, law, powers, x, std, float(2 * gradient @ x - x @ hessian @ x))


def _within(hessian: Real, gradient: Real, low: Real, high: Real) -> Real:
    """Where a quadratic is least between bounds."""
    values, along = np.linalg.eigh(hessian)
    kept = values > NOTHING * values[-1]
    root = np.sqrt(values[kept])
    rows, target = root[:, None] * along[:, kept].T, along[:, kept].T @ gradient / root
    return np.asarray(lsq_linear(rows, target, (low - NOTHING, high + NOTHING)).x)


def _system(
    ground: Ground,
    null: Candidate,
    sweeps: Sequence[tuple[Observation, Complex]],
    law: CurvedLaw,
    powers: Sequence[int],
) -> tuple[Real, Real, Real, Real]:
    """The plain twin's values and the curvatures as a linear problem: rows (m, u) and what the twin leaves, (m,).

    Then what is known of the u unknowns beforehand, their precision (u, u) and what pulls them to their mean, (u,).
    """
    problem = Problem.of(replace(ground, observations=tuple(o for o, _ in sweeps)), null.fit)
    linear = problem.linearised(null.fit)
    known = len(linear.pull)
    rows = []
    for (o, z), J in zip(sweeps, linear.columns, strict=True):
        of_values = np.zeros((*z.shape, known), dtype=complex)
        of_values[:, o.fundamental] = J
        bent = _columns(law, null.fit.rig, o, powers) * weight(o, ground.part.signal)[..., None]
        rows.append(stacked(np.concatenate([of_values, bent], axis=-1)))
    size = rows[0].shape[1]
    prior, pull = np.zeros((size, size)), np.zeros(size)
    prior[:known, :known], pull[:known] = problem.unknowns.prior, linear.pull
    return np.concatenate(rows), np.concatenate([stacked(z[..., None])[:, 0] for _, z in sweeps]), prior, pull


def _columns(law: CurvedLaw, rig: Rig, o: Observation, powers: Sequence[int]) -> Complex:
    """Change of a part's signal per curvature, (P, H, n, powers * n). Without means: no effect predicts them."""
    n = rig.n_axes
    out = np.zeros((len(o.axis), len(o.harmonics), n, len(powers), n), dtype=complex)
    for row, power in enumerate(powers):
        for k, harmonic in enumerate(o.harmonics):
            if harmonic and harmonic <= power and (power - harmonic) % 2 == 0:
                out[:, k, :, row] = law.change(rig, o, power, harmonic)
    return out.reshape(*out.shape[:3], len(powers) * n)
