"""A flexible mode whose stiffness or damping changes with its own swing, fitted to a plant as an effect would be.

Joints slip, shrink fits open: w^2 (1 + a |q|^2) and 2 zeta + b |q|^2 of the modal coordinate q. No law of the catalogue
does so, and another resonance beside the mode bends to the peak that it makes. Each input drives the mode to another
swing, which no linear effect can follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

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
BEGINNINGS = (*((s * way, 0.0) for s in SIZES for way in (1, -1)), *((0.0, s) for s in SIZES), (0.0, -0.3))
"""Changes of frequency and of damping at the largest swing, in half widths of the peak, from which a fit may begin."""
FITTED_BEGINNINGS = 2
"""Modes and beginnings, those that leave least, which are fitted."""
STEPS = 25
"""Evaluations of a fit."""
SETTLES = 60
"""Steps to the swing that a mode has with what that swing changes."""


@dataclass(frozen=True)
class ChangingMode:
    """A mode that changes with its swing, the datasheet's values fitted beside it."""

    ground: Ground
    null: Candidate
    """the plain twin"""
    mode: int
    solution: Real
    """the part's deviations, then changes of frequency and damping at the largest swing, in half widths, (a + 2,)"""
    largest: float
    """that swing squared, m^2 kg"""
    explained: float
    """of the plain twin's cost on the fitted sweeps"""

    @property
    def _own(self) -> tuple[float, float]:
        m = self.ground.nuisance.rig.rotor.modes[0][self.mode]
        return m.natural_frequency_rad_s, m.damping_ratio

    @property
    def frequency_hz(self) -> float:
        """Of the mode, by the datasheet."""
        return self._own[0] / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """The same."""
        return self._own[1]

    @property
    def frequency_change(self) -> float:
        """Relative, at the largest swing."""
        return float(self.solution[-2] * self._own[1])

    @property
    def damping_change(self) -> float:
        """Of the damping ratio, at the largest swing."""
        return float(self.solution[-1] * self._own[1])

    def explained_on(self, o: Observation, plain: Complex) -> float:
        """Chi-square that it takes off a sweep no fit has seen; ``plain`` is what the plain twin leaves, (P, H, n)."""
        left = _Fitted(self.ground, self.null, (o,), self.mode, self.largest).left(self.solution)
        return float(np.sum(np.abs(plain[:, o.fundamental]) ** 2) - np.sum(left**2))


def changing_mode(ground: Ground, null: Candidate) -> ChangingMode | None:
    """The changing mode that explains most of what the plain twin leaves; None of a part without modes."""
    modes = range(ground.nuisance.n_modes) if ground.part.path == "plant" else ()
    begun: list[tuple[float, int, Real]] = []
    problems = {mode: _Fitted.of(ground, null, mode) for mode in modes}
    for mode, problem in problems.items():
        begun += [(cost, mode, x) for cost, x in problem.beginnings()]
    found = []
    for _, mode, x in sorted(begun, key=lambda one: one[0])[:FITTED_BEGINNINGS]:
        problem = problems[mode]
        x = min(problem.plain, x, problem.fitted(x), key=problem.cost)
        explained = problem.cost(problem.plain) - problem.cost(x)
        found.append(ChangingMode(ground, null, mode, x, problem.largest, explained))
    return max(found, key=lambda c: c.explained, default=None)


class _Fitted:
    """The plant's fundamentals with a changing mode: residuals and derivatives for least squares."""

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
    def of(cls, ground: Ground, null: Candidate, mode: int) -> _Fitted:
        """Of all fitted sweeps; the largest swing is that of the plain twin."""
        swings = [swing_of(at_speed_of(null.fit.rig, o), o, mode) for o in ground.observations]
        largest = max(float(np.max(np.abs(swing.coordinate) ** 2)) for swing in swings)
        return cls(ground, null, ground.observations, mode, largest)

    def beginnings(self) -> list[tuple[float, Real]]:
        """Where a fit may begin, the datasheet's values as the plain twin has them, with what each leaves."""
        rig, out = self._rig(self.plain), []
        known = [
            (o, w, rest - displacement(rig, o), swing_of(at_speed_of(rig, o), o, self._mode))
            for o, w, rest in self._sweeps
        ]
        for own in BEGINNINGS:
            x = np.concatenate([self.plain[:-2], own])
            left = sum(float(np.sum(np.abs(w * (z - self._change(rig, o, s, x))) ** 2)) for o, w, z, s in known)
            out.append((left, x))
        return out

    def fitted(self, x: Real) -> Real:
        """Where least squares lead from there."""
        bound = np.concatenate([np.full(len(x) - 2, TOLERANCE_BOUND), [np.inf, np.inf]])
        inside = np.clip(x, -0.999 * bound, 0.999 * bound)
        return np.asarray(least_squares(self.residuals, inside, self.jacobian, (-bound, bound), max_nfev=STEPS).x)

    def cost(self, x: Real) -> float:
        return float(np.sum(self.residuals(x) ** 2))

    def residuals(self, x: Real) -> Real:
        """Weighted residuals, real and imaginary parts, and what is known of the values beforehand."""
        return np.concatenate([self.left(x), self._prior @ x[:-2]])

    def left(self, x: Real) -> Real:
        """The weighted residuals alone."""
        rig = self._rig(x)
        return np.concatenate(
            [stacked((w * (rest - self._answer(rig, o, x)))[..., None])[:, 0] for o, w, rest in self._sweeps]
        )

    def jacobian(self, x: Real) -> Real:
        """Derivatives of `residuals`; those by the datasheet's values are the small-signal twin's."""
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
        # at the largest swing: w (1 + x zeta) and zeta (1 + x)
        per_square = (2 * zeta * w**2 * x[-2] + 2j * zeta * w * omega * x[-1]) / self.largest
        square = np.abs(swing.coordinate) ** 2
        now = square.copy()
        for _ in range(SETTLES):
            now = np.sqrt(now * square / np.abs(1 + swing.own * per_square * now) ** 2)
        pushed = -per_square * now * swing.coordinate / (1 + swing.own * per_square * now)
        return np.asarray(np.einsum("pnv,pv->pn", swing.seen, pushed))
