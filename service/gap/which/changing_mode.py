"""A flexible mode whose stiffness or damping changes with its own amplitude, fitted to a plant as an effect would be.

Joints slip, shrink fits open: w^2 (1 + a |q|^2) and 2 zeta + b |q|^2, |q| the amplitude of the modal coordinate (a
describing function). No law of the catalogue is like it, and an extra resonance can imitate the distorted peak. But
each input drives the mode to another amplitude, which no linear effect can reproduce.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.fit import Problem
from service.gap.fitting.jacobian import Swing, displacement_jacobian, stacked, swing_of
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import at_speed_of, displacement, weight
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.measured.observation import Observation
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

SIZES = (0.03, 0.1, 0.3, 1.0, 3.0)
STARTS = (*((s * sign, 0.0) for s in SIZES for sign in (1, -1)), *((0.0, s) for s in SIZES), (0.0, -0.3))
"""Starts of a fit: changes of frequency and of damping at the largest amplitude, in half widths of the peak."""
FITTED_STARTS = 2
"""Number of (mode, start), those of least cost, that are fitted."""
MAX_EVALUATIONS, PRECISION = 25, 1e-4
"""Of a fit: evaluations, and the relative decrease of the cost or step of the solution at which it ends. Where no mode
changes it ends after a few steps, and where one does, far within the chi-square that it has to explain."""
AMPLITUDE_ITERATIONS = 60
"""Fixed-point iterations for the amplitude of a mode that depends on its own amplitude."""


@dataclass(frozen=True)
class ChangingMode:
    """A mode that changes with its amplitude, fitted beside the nuisance values."""

    ground: Ground
    null: Candidate
    """the plain twin"""
    mode: int
    solution: Real
    """(a + 2,) the part's nuisance values, then changes of frequency and damping at the largest amplitude, in half
    widths
    of the peak"""
    largest: float
    """that amplitude squared, m^2 kg"""
    explained: float
    """decrease of the plain twin's cost on the fitted sweeps"""

    @property
    def _own(self) -> tuple[float, float]:
        m = self.ground.nuisance.rig.rotor.modes[0][self.mode]
        return m.natural_frequency_rad_s, m.damping_ratio

    @property
    def frequency_hz(self) -> float:
        """Natural frequency of the mode by the datasheet."""
        return self._own[0] / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of the mode by the datasheet."""
        return self._own[1]

    @property
    def frequency_change(self) -> float:
        """Relative change of the natural frequency at the largest amplitude."""
        return float(self.solution[-2] * self._own[1])

    @property
    def damping_change(self) -> float:
        """Change of the damping ratio at the largest amplitude."""
        return float(self.solution[-1] * self._own[1])

    def explained_on(self, o: Observation, plain: Complex) -> float:
        """Chi-square that it takes off an unseen sweep; ``plain`` are the plain twin's residuals, (P, H, n)."""
        z = _ModeProblem(self.ground, self.null, (o,), self.mode, self.largest).weighted_residuals(self.solution)
        return float(np.sum(np.abs(plain[:, o.fundamental]) ** 2) - np.sum(z**2))


def changing_mode(ground: Ground, null: Candidate) -> ChangingMode | None:
    """The changing mode that takes most off the cost of the plain twin ``null``; None for a part without modes."""
    modes = range(ground.nuisance.n_modes) if ground.part.path == "plant" else ()
    starts: list[tuple[float, int, Real]] = []
    problems = {mode: _ModeProblem.of(ground, null, mode) for mode in modes}
    for mode, problem in problems.items():
        starts += [(cost, mode, x) for cost, x in problem.starts()]
    found = []
    for _, mode, x in sorted(starts, key=lambda start: start[0])[:FITTED_STARTS]:
        problem = problems[mode]
        x = min(problem.plain, x, problem.fitted(x), key=problem.cost)
        explained = problem.cost(problem.plain) - problem.cost(x)
        found.append(ChangingMode(ground, null, mode, x, problem.largest, explained))
    return max(found, key=lambda c: c.explained, default=None)


class _ModeProblem:
    """Least-squares problem of a changing mode and the nuisance values, on the plant's fundamentals."""

    def __init__(
        self, ground: Ground, null: Candidate, observations: Sequence[Observation], mode: int, largest: float
    ) -> None:
        self._ground, self._null, self._mode, self.largest = ground, null, mode, largest
        problem = Problem.of(ground, null.fit)
        self._active, n = ground.part.active, len(ground.part.active)
        self.plain: Real = np.concatenate([null.fit.theta[self._active], [0.0, 0.0]])
        self._amplifiers = ground.part.from_control or ground.inherited is not None
        self._prior = np.linalg.cholesky(problem.unknowns.prior[:n, :n]).T
        self._sweeps = []
        for o in observations:
            w = weight(o, "y")[:, o.fundamental]
            rest = o.Y[:, o.fundamental] - problem.model.beyond_linear(null.fit.rig, o)[:, o.fundamental]
            self._sweeps.append((o, w, rest))

    @classmethod
    def of(cls, ground: Ground, null: Candidate, mode: int) -> _ModeProblem:
        """The problem of all fitted sweeps; the largest amplitude is that of the plain twin."""
        swings = [swing_of(at_speed_of(null.fit.rig, o), o, mode) for o in ground.observations]
        largest = max(float(np.max(np.abs(swing.coordinate) ** 2)) for swing in swings)
        return cls(ground, null, ground.observations, mode, largest)

    def starts(self) -> list[tuple[float, Real]]:
        """Starts of a fit with their chi-squares; the nuisance values are the plain twin's."""
        rig, out = self._rig(self.plain), []
        known = [
            (o, w, rest - displacement(rig, o), swing_of(at_speed_of(rig, o), o, self._mode))
            for o, w, rest in self._sweeps
        ]
        for changes in STARTS:
            x = np.concatenate([self.plain[:-2], changes])
            chi_square = sum(float(np.sum(np.abs(w * (z - self._change(rig, o, s, x))) ** 2)) for o, w, z, s in known)
            out.append((chi_square, x))
        return out

    def fitted(self, x: Real) -> Real:
        """The solution of least squares from a start."""
        bound = np.concatenate([np.full(len(x) - 2, TOLERANCE_BOUND), [np.inf, np.inf]])
        inside = np.clip(x, -0.999 * bound, 0.999 * bound)
        return np.asarray(
            scipy.optimize.least_squares(
                self.residuals,
                inside,
                self.jacobian,
                (-bound, bound),
                ftol=PRECISION,
                xtol=PRECISION,
                max_nfev=MAX_EVALUATIONS,
            ).x
        )

    def cost(self, x: Real) -> float:
        """Chi-square and penalty."""
        return float(np.sum(self.residuals(x) ** 2))

    def residuals(self, x: Real) -> Real:
        """Weighted residuals, then those of the priors of the nuisance values."""
        return np.concatenate([self.weighted_residuals(x), self._prior @ x[:-2]])

    def weighted_residuals(self, x: Real) -> Real:
        """Weighted residuals of all sweeps, real parts and then imaginary ones of each."""
        rig = self._rig(x)
        return np.concatenate(
            [stacked((w * (rest - self._answer(rig, o, x)))[..., None])[:, 0] for o, w, rest in self._sweeps]
        )

    def jacobian(self, x: Real) -> Real:
        """Derivatives of `residuals`; those with respect to nuisance values are the small-signal twin's."""
        rig, rows = self._rig(x), []
        for o, w, _ in self._sweeps:
            swing = swing_of(at_speed_of(rig, o), o, self._mode)
            J = displacement_jacobian(self._ground.nuisance, rig, o, self._amplifiers)[:, :, self._active]
            now = self._change(rig, o, swing, x)
            moved = [(self._change(rig, o, swing, x + step) - now) / step.max() for step in 1e-4 * np.eye(len(x))[-2:]]
            rows.append(stacked(w[..., None] * np.concatenate([J, np.stack(moved, axis=-1)], axis=-1)))
        known = np.concatenate([self._prior, np.zeros((len(self._prior), 2))], axis=1)
        return np.concatenate([*(-r for r in rows), known])

    def _rig(self, x: Real) -> Rig:
        theta = self._null.fit.theta.copy()
        theta[self._active] = x[:-2]
        return self._ground.fitted_rig(theta, self._null.fit.inherited)

    def _answer(self, rig: Rig, o: Observation, x: Real) -> Complex:
        swing = swing_of(at_speed_of(rig, o), o, self._mode)
        return np.asarray(displacement(rig, o) + self._change(rig, o, swing, x))

    def _change(self, rig: Rig, o: Observation, swing: Swing, x: Real) -> Complex:
        """What the changing mode adds to the sensors' signals, (P, n)."""
        omega = 2 * np.pi * o.points_hz[:, None]
        w = np.array([plane[self._mode].natural_frequency_rad_s for plane in rig.rotor.modes])
        zeta = np.array([plane[self._mode].damping_ratio for plane in rig.rotor.modes])
        # modal force per coordinate and per squared amplitude; at the largest amplitude w (1 + x zeta) and zeta (1 + x)
        per_square = (2 * zeta * w**2 * x[-2] + 2j * zeta * w * omega * x[-1]) / self.largest
        linear_square = np.abs(swing.coordinate) ** 2
        square = linear_square.copy()
        for _ in range(AMPLITUDE_ITERATIONS):
            square = np.sqrt(square * linear_square / np.abs(1 + swing.own * per_square * square) ** 2)
        force = -per_square * square * swing.coordinate / (1 + swing.own * per_square * square)
        return np.asarray(np.einsum("pnv,pv->pn", swing.seen, force))
