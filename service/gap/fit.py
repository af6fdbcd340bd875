"""Maximum a posteriori fit of a twin, with chosen effects, to observations: Levenberg-Marquardt.

Every candidate is fitted beside the datasheet's uncertain values, each under its tolerance as a unit-normal
prior; an effect's own parameters range freely between their bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.jacobian import answer_and_jacobian
from service.gap.nuisance import Nuisance
from service.gap.observation import Observation
from service.gap.predict import answer, at_speed_of, centred, control, linear_answer, measured, weights
from sim.effect import Effect, Parameter
from sim.rig import Rig
from sim.twin import LinearModel, linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP = 1e-3
"""Forward difference of an effect's parameter, in units of its scale."""
TOLERANCE_BOUND = 4.0
"""A datasheet's value may be off by this many of its tolerances; what lies beyond is a gap, not an uncertainty."""


@dataclass(frozen=True)
class Stage:
    """How exact a pass of the fit is.

    ``closed`` compares the closed loop's answer to r, smooth where the plant has sharp peaks;
    ``relative_floor`` is an error allowed beside the noise, relative to the largest signal of a point.
    """

    closed: bool
    relative_floor: float
    iterations: int
    tolerance: float


COARSE = Stage(closed=True, relative_floor=0.03, iterations=10, tolerance=5e-3)
MIDDLE = Stage(closed=True, relative_floor=0.003, iterations=8, tolerance=5e-3)
PROBE = Stage(closed=False, relative_floor=0.0, iterations=4, tolerance=5e-3)
EXACT = Stage(closed=False, relative_floor=0.0, iterations=15, tolerance=5e-4)


@dataclass(frozen=True)
class Fit:
    """A fitted twin."""

    effects: tuple[str, ...]
    theta: Real
    """(k,) deviations from the datasheet, in units of the tolerances"""
    values: tuple[dict[str, float], ...]
    """parameters of each effect"""
    rig: Rig
    chi_square: float
    """of the weighted residuals, all harmonics"""
    n_residuals: int
    curvature: Real
    """(k + e, k + e), J^T J of the weighted residuals; effect parameters in units of their scale"""
    status: str

    @property
    def penalty(self) -> float:
        """|theta|^2, what the datasheet's tolerances hold against the fit."""
        return float(self.theta @ self.theta)


class Problem:
    """Observations, a datasheet's uncertain values, and the effects that are fitted beside them."""

    def __init__(self, nuisance: Nuisance, observations: Sequence[Observation], effects: Sequence[Effect] = ()) -> None:
        self.nuisance, self.observations, self.effects = nuisance, tuple(observations), tuple(effects)
        self.parameters = [(k, p) for k, e in enumerate(effects) for p in e.parameters]
        self.scale: Real = np.array([_scale(p) for _, p in self.parameters], dtype=float)
        self.low: Real = np.array([self._inner(p, p.low) for _, p in self.parameters], dtype=float) / self.scale
        self.high: Real = np.array([self._inner(p, p.high) for _, p in self.parameters], dtype=float) / self.scale
        self.nonlinear = any(e.nonlinear for e in effects)
        self._k = len(nuisance)

    @staticmethod
    def _inner(p: Parameter, value: float) -> float:
        """A parameter as the fit sees it: magnitudes over decades by their logarithm."""
        return float(np.log(np.clip(value, p.low, p.high))) if p.scale == "log" else value

    def values(self, e: Real) -> tuple[dict[str, float], ...]:
        """Effect parameters by name, one dict per effect, from the scaled vector."""
        inside = np.clip(e, self.low, self.high) * self.scale
        out: list[dict[str, float]] = [{} for _ in self.effects]
        for (k, p), v in zip(self.parameters, inside, strict=True):
            out[k][p.name] = float(np.clip(np.exp(v), p.low, p.high)) if p.scale == "log" else float(v)
        return tuple(out)

    def scaled(self, values: Sequence[Mapping[str, float]]) -> Real:
        """Inverse of `values`; parameters not given keep their typical value."""
        inner = [self._inner(p, values[k].get(p.name, p.typical)) for k, p in self.parameters]
        return np.asarray(np.array(inner, dtype=float) / self.scale)

    def build(self, theta: Real, e: Real) -> Rig:
        """The rig at deviations ``theta`` with effects ``e``."""
        rig = self.nuisance.at(theta)
        for effect, values in zip(self.effects, self.values(e), strict=True):
            rig = effect.on(rig, **values)
        return rig

    # ------------------------------------------------------------------------------------------- predictions

    def _closed_control(self, o: Observation, model: LinearModel) -> Complex:
        """Control signal that the twin's loop would have for the excitation the controller really saw."""
        f = o.fundamental
        C = model.controller[o.line, None]
        excitation = o.U[:, f] + C * o.Y[:, f]  # not r itself: a controller that differs is not the plant's fault
        return np.asarray((model.sensitivity[o.line] @ excitation[..., None])[..., 0])

    def predict(self, rig: Rig, o: Observation, closed: bool, carried: Complex | None = None) -> Complex:
        """Answer [u, i, y] to the measured control signal, (P, H, 3 n).

        ``carried`` is what the magnets' nonlinearity adds to the small-signal answer of [i, y], (P, H, 2 n), all
        harmonics; it hardly changes while a linear effect is fitted, so it is computed once a stage.
        """
        n, f = rig.n_axes, o.fundamental
        nonlinear = self.beyond_linear(rig, o) if carried is None or self.nonlinear else carried
        out = np.empty((*o.U.shape[:2], 3 * n), dtype=complex)
        out[:, :, :n] = control(rig, o)
        out[:, :, n:] = nonlinear
        if closed:
            model = linear_model(at_speed_of(rig, o), o.frequency_hz)
            U = self._closed_control(o, model)[..., None]
            out[:, f, n : 2 * n] += (model.i_per_u[o.line] @ U)[..., 0]
            out[:, f, 2 * n :] += (model.y_per_u[o.line] @ U)[..., 0]
        else:
            out[:, f, n:] += linear_answer(rig, o)
        return out

    @staticmethod
    def beyond_linear(rig: Rig, o: Observation) -> Complex:
        """Answer of [i, y] without its small-signal fundamental, (P, H, 2 n)."""
        out = answer(rig, o)
        out[:, o.fundamental] -= linear_answer(rig, o)
        return out

    @staticmethod
    def _with_control(o: Observation, U: Complex) -> Observation:
        new = o.U.copy()
        new[:, o.fundamental] = U
        return replace(o, U=new)

    def _nuisance_columns(self, rig: Rig, o: Observation, closed: bool) -> Complex:
        """Derivative of the fundamental of [i, y] by theta, (P, 2 n, k)."""
        n = rig.n_axes
        if not closed:
            return answer_and_jacobian(self.nuisance, rig, o)[1]
        model = linear_model(at_speed_of(rig, o), o.frequency_hz)
        _, J = answer_and_jacobian(self.nuisance, rig, self._with_control(o, self._closed_control(o, model)))
        C = model.controller[:, None, None]
        S = np.linalg.inv(np.eye(n) + model.y_per_u * C)[o.line]
        J[:, n:] = S @ J[:, n:]
        J[:, :n] -= (model.i_per_u * C)[o.line] @ J[:, n:]
        return J

    def _effect_columns(
        self, theta: Real, e: Real, o: Observation, closed: bool, at: Complex, carried: Complex
    ) -> Complex:
        """Derivative of `predict` by the effects' parameters, (P, H, 3 n, e); ``at`` is the prediction itself."""
        columns = np.zeros((*at.shape, len(e)), dtype=complex)
        for j in range(len(e)):
            moved = e.copy()
            moved[j] += STEP if e[j] + STEP <= self.high[j] else -STEP
            there = self.predict(self.build(theta, moved), o, closed, carried)
            columns[..., j] = (there - at) / (moved[j] - e[j])
        return columns

    # ------------------------------------------------------------------------------------------------- fit

    def _weights(self, stage: Stage) -> list[Real]:
        out = []
        for o in self.observations:
            w, m = weights(o), measured(o)[:, [o.fundamental]]
            if stage.relative_floor:
                n = m.shape[2] // 3
                size = np.concatenate([np.abs(m[..., k * n : (k + 1) * n]).max(2) for k in range(3)], axis=1)
                floor = stage.relative_floor * np.repeat(size, n, axis=1)[:, None, :]
                w = np.where(w > 0, 1 / np.hypot(1 / np.maximum(w, 1e-300), floor), 0.0)
            out.append(w)
        return out

    def _residuals(
        self, rig: Rig, stage: Stage, w: list[Real], carried: list[Complex]
    ) -> tuple[list[Complex], list[Complex], float]:
        """Weighted residuals (P, H, 3 n) and predictions per observation, and chi-square."""
        predictions = [self.predict(rig, o, stage.closed, c) for o, c in zip(self.observations, carried, strict=True)]
        residuals = [
            centred(measured(o) - p, weight, o) * weight
            for o, p, weight in zip(self.observations, predictions, w, strict=True)
        ]
        return residuals, predictions, float(sum(np.vdot(r, r).real for r in residuals))

    def _normal_equations(
        self,
        x: Real,
        rig: Rig,
        stage: Stage,
        w: list[Real],
        residuals: list[Complex],
        predictions: list[Complex],
        carried: list[Complex],
    ) -> tuple[Real, Real]:
        """J^T J and J^T r. The datasheet's values move only the fundamental of i and y, so only that is stacked."""
        k, m = self._k, len(x)
        curvature, gradient = np.zeros((m, m)), np.zeros(m)
        for o, weight, r, p, c in zip(self.observations, w, residuals, predictions, carried, strict=True):
            n, f = rig.n_axes, o.fundamental
            J = _real(self._nuisance_columns(rig, o, stage.closed) * weight[:, f, n:, None])
            curvature[:k, :k] += J.T @ J
            gradient[:k] += J.T @ _real(r[:, f, n:, None])[:, 0]
            if m > k:
                E = self._effect_columns(x[:k], x[k:], o, stage.closed, p, c)
                E = centred(E, weight, o) * weight[..., None]
                cross = J.T @ _real(E[:, f, n:])
                flat = _real(E)
                curvature[:k, k:] += cross
                curvature[k:, :k] += cross.T
                curvature[k:, k:] += flat.T @ flat
                gradient[k:] += flat.T @ _real(r[..., None])[:, 0]
        return curvature, gradient

    def run(self, theta: Real, e: Real, stage: Stage) -> tuple[Real, Real, Fit]:
        """One Levenberg-Marquardt pass; returns the parameters and the fit."""
        w, k = self._weights(stage), self._k
        prior = np.concatenate([np.ones(k), np.zeros(len(e))])
        x = np.concatenate([theta, e])
        bound = np.full(k, TOLERANCE_BOUND)
        low, high = np.concatenate([-bound, self.low]), np.concatenate([bound, self.high])
        rig = self.build(x[:k], x[k:])
        carried = [self.beyond_linear(rig, o) for o in self.observations]
        r, predictions, chi_square = self._residuals(rig, stage, w, carried)
        cost = chi_square + float(x**2 @ prior)
        damping, status, curvature = 1e-3, "reached the largest number of iterations", np.zeros((len(x), len(x)))
        for iteration in range(stage.iterations):
            curvature, gradient = self._normal_equations(x, rig, stage, w, r, predictions, carried)
            hessian = curvature + np.diag(prior)
            scale = np.diag(np.maximum(np.diag(hessian), 1e-12))
            accepted = False
            for _ in range(7):
                step = np.linalg.solve(hessian + damping * scale, gradient - prior * x)
                trial = np.clip(x + np.clip(step, -4.0, 4.0), low, high)
                trial_rig = self.build(trial[:k], trial[k:])
                trial_r, trial_predictions, trial_chi = self._residuals(trial_rig, stage, w, carried)
                trial_cost = trial_chi + float(trial**2 @ prior)
                if np.isfinite(trial_cost) and trial_cost < cost:
                    accepted = True
                    break
                damping = max(damping * 10, 1e-6)
            if not accepted:
                status = "no step lowers the cost"
                break
            damping = max(damping / 10, 1e-9)
            drop = cost - trial_cost
            x, rig, r, predictions, chi_square, cost = (
                trial,
                trial_rig,
                trial_r,
                trial_predictions,
                trial_chi,
                trial_cost,
            )
            if not stage.closed and not self.nonlinear and iteration < 4:
                carried = [self.beyond_linear(rig, o) for o in self.observations]
                r, predictions, chi_square = self._residuals(rig, stage, w, carried)
                cost = chi_square + float(x**2 @ prior)
            if drop < stage.tolerance * max(1.0, cost):
                status = "converged"
                break
        count = sum(2 * int((weight > 0).sum()) for weight in w)
        names = tuple(effect.id for effect in self.effects)
        return x[:k], x[k:], Fit(names, x[:k], self.values(x[k:]), rig, chi_square, count, curvature, status)

    def staged(self, theta: Real, e: Real, stages: Sequence[Stage] = (COARSE, MIDDLE, EXACT)) -> Fit:
        """Fit through stages of growing exactness, each from where the last one ended."""
        fit: Fit | None = None
        for stage in stages:
            theta, e, fit = self.run(theta, e, stage)
        assert fit is not None
        return fit


def _real(x: Complex) -> Real:
    """(..., columns) complex -> (2 rows, columns): real parts, then imaginary ones."""
    flat = x.reshape(-1, x.shape[-1])
    return np.concatenate([flat.real, flat.imag])


def _scale(p: Parameter) -> float:
    """Size of one unit of an effect's parameter in the fit."""
    return 1.0 if p.scale == "log" else abs(p.typical - p.null) or abs(p.high - p.low)
