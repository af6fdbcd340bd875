"""A curved characteristic, x + c2 x^2 + c3 x^3 + .., fitted to a part of the loop as an effect would be.

The catalogue has no law with a smoothly nonlinear sensor, amplifier or bearing force. Its nonlinear effects make
harmonics and change the response with amplitude, too, so one of them may be mistaken for such a characteristic. The
response is linear in the curvatures, and to first order in the nuisance values beside them: one linear least squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

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
"""Share of the largest eigenvalue below which a direction of the unknowns is taken as unobservable."""
CHI_SQUARE_SHOWN = 36.0
"""Chi-square that a further power must take off to be included; else it would only widen the deviation of the third."""


@dataclass(frozen=True)
class Curvature:
    """A part's curved characteristic, fitted beside the nuisance values."""

    ground: Ground
    null: Candidate
    """the plain twin"""
    law: CurvedLaw
    powers: tuple[int, ...]
    solution: Real
    """(a + powers * n,) changes of the plain twin's values, then curvatures"""
    deviation: Real
    """(a + powers * n,) standard deviation of each; infinite where it is unobservable"""
    explained: float
    """decrease of the plain twin's cost on the fitted sweeps"""

    @property
    def value(self) -> Real:
        """Curvatures of `POWERS`, (powers, n), 1/m, 1/A and their squares."""
        return self._curvatures(self.solution)

    @property
    def std(self) -> Real:
        """Their standard deviations, (powers, n)."""
        return self._curvatures(self.deviation)

    def explained_on(self, o: Observation, plain: Complex) -> float:
        """Chi-square that it takes off an unseen sweep; ``plain`` are the plain twin's residuals, (P, H, n)."""
        rows, z, *_ = _system(self.ground, self.null, [(o, plain)], self.law, self.powers)
        return float(z @ z - np.sum((z - rows @ self.solution) ** 2))

    def _curvatures(self, x: Real) -> Real:
        """The curvatures of `POWERS` among the unknowns, (powers, n)."""
        n = self.ground.nuisance.rig.n_axes
        return x[len(x) - len(self.powers) * n :].reshape(len(self.powers), n)[: len(POWERS)]


def curvatures(ground: Ground, null: Candidate, plain: Sequence[Complex]) -> list[Curvature]:
    """Each possible curved characteristic of a part, fitted to the plain twin's residuals, (P, H, n) per sweep.

    A higher power is included only where it explains enough.
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
    """The bounded linear least-squares fit of a characteristic with these powers."""
    sweeps = list(zip(ground.observations, plain, strict=True))
    rows, z, prior, pull = _system(ground, null, sweeps, law, powers)
    hessian = rows.T @ rows + prior
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))  # a curvature is per m^2, a deviation per tolerance
    inverse = np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    gradient = rows.T @ z + pull
    # Without bounds a linearised nuisance value could compensate for anything, many tolerances away.
    now = null.fit.theta[ground.part.active]
    low, high = (np.full(len(scale), far) for far in (-np.inf, np.inf))
    low[: len(now)], high[: len(now)] = -TOLERANCE_BOUND - now, TOLERANCE_BOUND - now
    x = bounded_minimum(hessian / np.outer(scale, scale), gradient / scale, low * scale, high * scale) / scale
    variance = np.diag(inverse)
    std = np.where(variance > 0, np.sqrt(np.maximum(variance, 0)), np.inf)
    return Curvature(ground, null, law, powers, x, std, float(2 * gradient @ x - x @ hessian @ x))


def bounded_minimum(hessian: Real, gradient: Real, low: Real, high: Real) -> Real:
    """The minimum x, (u,), of x^T hessian x / 2 - gradient^T x between bounds.

    ``hessian`` is (u, u), positive semidefinite; the others are (u,).
    """
    values, along = np.linalg.eigh(hessian)
    observable = values > NOTHING * values[-1]
    root = np.sqrt(values[observable])
    rows, target = root[:, None] * along[:, observable].T, along[:, observable].T @ gradient / root
    free = np.linalg.lstsq(rows, target, rcond=None)[0]
    if np.all((low <= free) & (free <= high)):  # often; to load the library below takes a third of a second
        return np.asarray(free)
    return np.asarray(scipy.optimize.lsq_linear(rows, target, (low - NOTHING, high + NOTHING)).x)


def _system(
    ground: Ground,
    null: Candidate,
    sweeps: Sequence[tuple[Observation, Complex]],
    law: CurvedLaw,
    powers: Sequence[int],
) -> tuple[Real, Real, Real, Real]:
    """Linear problem of u unknowns, changes of the plain twin's values and then curvatures.

    Returns the design matrix (m, u) and the plain twin's residuals (m,), then the prior precision (u, u) and the
    prior's pull (u,) of `Linearised`.
    """
    problem = Problem.of(replace(ground, observations=tuple(o for o, _ in sweeps)), null.fit)
    linear = problem.linearised(null.fit)
    known = len(linear.pull)
    rows = []
    for (o, z), J in zip(sweeps, linear.columns, strict=True):
        of_values = np.zeros((*z.shape, known), dtype=complex)
        of_values[:, o.fundamental] = J
        of_curvatures = _columns(law, null.fit.rig, o, powers) * weight(o, ground.part.signal)[..., None]
        rows.append(stacked(np.concatenate([of_values, of_curvatures], axis=-1)))
    size = rows[0].shape[1]
    prior, pull = np.zeros((size, size)), np.zeros(size)
    prior[:known, :known], pull[:known] = problem.unknowns.prior, linear.pull
    return np.concatenate(rows), np.concatenate([stacked(z[..., None])[:, 0] for _, z in sweeps]), prior, pull


def _columns(law: CurvedLaw, rig: Rig, o: Observation, powers: Sequence[int]) -> Complex:
    """Change of a part's signal per curvature, (P, H, n, powers * n); zero at harmonic 0, which is not used."""
    n = rig.n_axes
    out = np.zeros((len(o.axis), len(o.harmonics), n, len(powers), n), dtype=complex)
    for row, power in enumerate(powers):
        for k, harmonic in enumerate(o.harmonics):
            if harmonic and harmonic <= power and (power - harmonic) % 2 == 0:
                out[:, k, :, row] = law.change(rig, o, power, harmonic)
    return out.reshape(*out.shape[:3], len(powers) * n)
