"""Maximum a posteriori fit of one part of the loop, with chosen effects, to observations: Levenberg-Marquardt.

Every candidate is fitted beside the datasheet's uncertain values, each under its tolerance as a unit-normal
prior; an effect's own parameters range freely between their bounds. The derivatives by the datasheet's values
change little from step to step, so they are kept until a step fails with them (the chord method).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import OUT_OF_STEPS, Fit, Linearised
from service.gap.fitting.jacobian import current_jacobian, displacement_jacobian, stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import (
    at_speed_of,
    centred,
    control,
    current,
    displacement,
    measured_signal,
    weight,
    whole_displacement,
)
from service.gap.fitting.stage import EXACT, Stage
from service.gap.fitting.unknowns import Unknowns, asleep
from service.gap.measured.observation import Observation
from sim.effects import CATALOGUE
from sim.rig import Rig
from sim.twin import LinearModel, linear_model

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Carried = Sequence[Complex | None]
"""What the magnets' nonlinearity adds to the small-signal displacement of each sweep, (P, H, n); None: not known."""

STEP = 2e-5
"""Forward difference of an effect's parameter, in units of its scale."""
TOLERANCE_BOUND = 4.0
"""A datasheet's value may be off by this many of its tolerances; what lies beyond is a gap, not an uncertainty."""
CHORD = 4
"""Steps for which the derivatives by the datasheet's values, and by what is inherited, are kept."""
SETTLING = 3
"""Steps of the datasheet's values alone before a force law is fitted."""
WITHIN_FLOOR = 0.02
"""Cost per residual from which a stage with a floor of its own hands over: 0.14 of the floor, root mean square."""


@dataclass
class _State:
    """Where a pass of the fit stands."""

    x: Real
    rig: Rig
    residuals: list[Complex]
    predictions: list[Complex]
    cost: float

    @property
    def size(self) -> int:
        """Number of residuals, real and imaginary parts apart."""
        return sum(2 * r.size for r in self.residuals)


class Problem(Unknowns):
    """Observations of a part of the loop, its uncertain values, and the effects that are fitted beside them."""

    @classmethod
    def of(cls, ground: Ground, fit: Fit) -> Problem:
        """The problem that a fit has solved, but for what was held where a law is the plainest."""
        return cls(ground, [CATALOGUE[name] for name in fit.effects], asleep(fit.effects, fit.values))

    # ------------------------------------------------------------------------------------------- predictions

    def _closed_control(self, o: Observation, model: LinearModel) -> Complex:
        """Control signal that the twin's loop would have for the excitation the controller really saw."""
        f = o.fundamental
        C, late = model.controller[o.line, None], model.log_phase[o.line, None]
        # Not r itself: a controller that differs is not the plant's fault. With a log that is off, still of the loop
        # that runs: that of the log could be nearly unstable.
        excitation = late * o.U[:, f] + C * o.Y[:, f]
        return np.asarray((model.u_per_r[o.line] @ excitation[..., None])[..., 0])

    def predict(self, rig: Rig, o: Observation, closed: bool, carried: Complex | None = None) -> Complex:
        """The part's output for its measured input, (P, H, n).

        ``carried`` is what the magnets' nonlinearity adds to the small-signal displacement, (P, H, n), all
        harmonics; it hardly changes while a linear effect is fitted, so it is computed once a stage.
        """
        if self._signal == "u":
            return control(rig, o)
        if self._signal == "i":
            return current(rig, o)
        if carried is None and not closed:
            return whole_displacement(rig, o)
        f = o.fundamental
        out = self.beyond_linear(rig, o) if carried is None else carried.copy()
        if closed:
            model = linear_model(at_speed_of(rig, o), o.frequency_hz)
            out[:, f] += (model.y_per_u[o.line] @ self._closed_control(o, model)[..., None])[..., 0]
        else:
            out[:, f] += displacement(rig, o)
        return out

    def _carried(self, rig: Rig) -> Carried:
        """What `predict` is to carry, sweep by sweep; nothing where an effect's own force changes from step to step."""
        return [None if self.nonlinear else self.beyond_linear(rig, o) for o in self.observations]

    def beyond_linear(self, rig: Rig, o: Observation) -> Complex:
        """Displacement without its small-signal fundamental, (P, H, n); other parts have nothing of the kind."""
        if self._signal != "y":
            return np.zeros((*o.U.shape[:2], 0), dtype=complex)
        out = whole_displacement(rig, o)
        out[:, o.fundamental] -= displacement(rig, o)
        return out

    def _nuisance_columns(self, rig: Rig, o: Observation, closed: bool) -> Complex:
        """Derivative of the fundamental by the active values, (P, n, a)."""
        n, nuisance = rig.n_axes, self.ground.nuisance
        if self._signal == "u":
            return np.zeros((len(o.line), n, 0), dtype=complex)
        if self._signal == "i":
            return current_jacobian(nuisance, rig, o)
        amplifiers = self.ground.part.from_control or self.ground.inherited is not None
        if not closed:
            return displacement_jacobian(nuisance, rig, o, amplifiers)[:, :, self.active]
        model = linear_model(at_speed_of(rig, o), o.frequency_hz)
        U = o.U.copy()
        U[:, o.fundamental] = self._closed_control(o, model)
        J = displacement_jacobian(nuisance, rig, replace(o, U=U), amplifiers)[:, :, self.active]
        C = (model.controller / model.log_phase)[:, None, None]
        return np.asarray(np.linalg.inv(np.eye(n) + model.y_per_u * C)[o.line] @ J)

    def _effect_columns(self, state: _State, stage: Stage, w: list[Real], carried: Carried, of: range) -> list[Complex]:
        """Weighted derivatives of the predictions by some of the effects' parameters, (P, H, n, len(of)) per sweep."""
        columns = [np.zeros((*p.shape, len(of)), dtype=complex) for p in state.predictions]
        for column_of, j in enumerate(of):
            if self.low[j] == self.high[j]:  # held
                continue
            moved = state.x.copy()
            at = self._a + j
            moved[at] += STEP if moved[at] + STEP <= self.high[j] else -STEP
            rig = self.build(moved)
            for column, o, c, p in zip(columns, self.observations, carried, state.predictions, strict=True):
                column[..., column_of] = (self.predict(rig, o, stage.closed, c) - p) / (moved[at] - state.x[at])
        return [
            centred(column, weight_, o) * weight_[..., None]
            for column, weight_, o in zip(columns, w, self.observations, strict=True)
        ]

    # ------------------------------------------------------------------------------------------------- fit

    def _weights(self, stage: Stage) -> list[Real]:
        out = []
        for o in self.observations:
            w = weight(o, self._signal)
            if stage.relative_floor:
                size = np.abs(measured_signal(o, self._signal)[:, o.fundamental]).max(axis=1)
                floor = stage.relative_floor * size[:, None, None]
                w = np.where(w > 0, 1 / np.hypot(1 / np.maximum(w, 1e-300), floor), 0.0)
            out.append(w)
        return out

    def _state(self, x: Real, stage: Stage, w: list[Real], carried: Carried) -> _State:
        rig = self.build(x)
        predictions = [self.predict(rig, o, stage.closed, c) for o, c in zip(self.observations, carried, strict=True)]
        residuals = [
            centred(measured_signal(o, self._signal) - p, weight_, o) * weight_
            for o, p, weight_ in zip(self.observations, predictions, w, strict=True)
        ]
        cost = float(sum(np.vdot(r, r).real for r in residuals)) + self._penalty(x)
        return _State(x, rig, residuals, predictions, cost)

    def _nuisance_rows(self, rig: Rig, stage: Stage, w: list[Real]) -> list[Real]:
        """Weighted derivatives of the fundamentals by the active values, one (2 P n, a) per sweep."""
        return [
            stacked(self._nuisance_columns(rig, o, stage.closed) * weight_[:, o.fundamental, :, None])
            for o, weight_ in zip(self.observations, w, strict=True)
        ]

    def _normal_equations(self, state: _State, rows: list[Real], columns: list[Complex]) -> tuple[Real, Real]:
        """J^T J and J^T r. The datasheet's values move only the fundamental, so only that is stacked for them."""
        a, m = self._a, len(state.x)
        curvature, gradient = np.zeros((m, m)), np.zeros(m)
        for o, r, J, E in zip(self.observations, state.residuals, rows, columns, strict=True):
            f = o.fundamental
            curvature[:a, :a] += J.T @ J
            gradient[:a] += J.T @ stacked(r[:, f, :, None])[:, 0]
            if m > a:
                cross, flat = J.T @ stacked(E[:, f]), stacked(E)
                curvature[:a, a:] += cross
                curvature[a:, :a] += cross.T
                curvature[a:, a:] += flat.T @ flat
                gradient[a:] += flat.T @ stacked(r[..., None])[:, 0]
        return curvature, gradient

    def settled(self, x: Real) -> tuple[float, Real]:
        """Cost and ``x``, the datasheet's values where the effects as they are leave least: a few Gauss-Newton steps.

        A force law that starts far from its valley turns stiffnesses and gains over; what is left then misleads.
        """
        a, w = self._a, self._weights(EXACT)
        state = self._state(x, EXACT, w, self._carried(self.build(x)))
        for _ in range(SETTLING):
            rows = self._nuisance_rows(state.rig, EXACT, w)
            nothing = [np.zeros((*p.shape, len(x) - a), dtype=complex) for p in state.predictions]
            curvature, gradient = self._normal_equations(state, rows, nothing)
            hessian, pull = (curvature + self.prior)[:a, :a], (self.prior @ (state.x - self._centre))[:a]
            moved = state.x.copy()
            moved[:a] += np.linalg.solve(hessian, gradient[:a] - pull)
            moved[:a] = np.clip(moved[:a], -TOLERANCE_BOUND, TOLERANCE_BOUND)
            trial = self._state(moved, EXACT, w, self._carried(self.build(moved)))
            if not trial.cost < state.cost:
                break
            state = trial
        return state.cost, state.x

    def run(self, x: Real, stage: Stage) -> Fit:
        """One Levenberg-Marquardt pass from ``x`` (a + e,)."""
        a, w = self._a, self._weights(stage)
        bound = np.full(a, TOLERANCE_BOUND)
        longest = np.concatenate([bound, self._longest])
        low, high = np.concatenate([-bound, self.low]), np.concatenate([bound, self.high])
        begun = self.build(x)
        carried = self._carried(begun)
        state = self._state(x, stage, w, carried)
        damping, status = 1e-3, OUT_OF_STEPS
        own, theirs = range(self.n_own), range(self.n_own, len(self.scale))
        rows, inherited, age = [], [], CHORD
        curvature = np.zeros((len(x), len(x)))
        for iteration in range(stage.iterations):
            if age >= CHORD:
                rows, age = self._nuisance_rows(state.rig, stage, w), 0
                inherited = self._effect_columns(state, stage, w, carried, theirs)
            columns = [
                np.concatenate(both, axis=-1)
                for both in zip(self._effect_columns(state, stage, w, carried, own), inherited, strict=True)
            ]
            curvature, gradient = self._normal_equations(state, rows, columns)
            hessian = curvature + self.prior
            scale = np.diag(np.maximum(np.diag(hessian), 1e-12))
            trial = None
            for _ in range(7 if age == 0 else 2):
                pull = gradient - self.prior @ (state.x - self._centre)
                step = _within(hessian + damping * scale, pull, state.x <= low, state.x >= high)
                tried = np.clip(state.x + np.clip(step, -longest, longest), low, high)
                found = self._state(tried, stage, w, carried)
                if np.isfinite(found.cost) and found.cost < state.cost:
                    trial = found
                    break
                damping = max(damping * 10, 1e-6)
            if trial is None and age > 0:
                age, damping = CHORD, 1e-3  # the derivatives are too old
                continue
            if trial is None:
                status = "no step lowers the cost"
                break
            damping, age = max(damping / 10, 1e-9), age + 1
            drop, state = state.cost - trial.cost, trial
            if not stage.closed and not self.nonlinear and self._signal == "y" and iteration < 4:
                carried = self._carried(state.rig)
                state = self._state(state.x, stage, w, carried)
            if _within_floor(state, stage) or drop < stage.tolerance * max(1.0, state.cost):
                status = "converged"
                break
        return self._fit(state, w, curvature, status)

    def _fit(self, state: _State, w: list[Real], curvature: Real, status: str) -> Fit:
        groups: list[tuple[float, int]] = []
        across: list[tuple[float, int]] = []

        def chi_square(r: Complex, weight_: Real) -> tuple[float, int]:
            return float(np.sum(np.abs(r) ** 2)), 2 * int((weight_ > 0).sum())

        for o, r, weight_ in zip(self.observations, state.residuals, w, strict=True):
            own = np.arange(len(o.harmonics)) == o.fundamental
            groups += [chi_square(r[:, chosen], weight_[:, chosen]) for chosen in (own, ~own)]
            other_plane = np.arange(r.shape[2]) // 2 != o.axis[:, None] // 2
            across.append(chi_square(r[:, o.fundamental][other_plane], weight_[:, o.fundamental][other_plane]))
        a = self._a
        theta, values = self.theta(state.x), self.values(state.x[a:])
        penalty, n = self._price(state.x), len(self.effects)
        names = tuple(effect.id for effect in self.effects)
        return Fit(
            names,
            theta,
            values[:n],
            state.rig,
            tuple(groups),
            penalty,
            self.active,
            curvature,
            status,
            values[n:],
            tuple(across),
            self.ends(state.x[a:]),
        )

    def linearised(self, fit: Fit) -> Linearised:
        """The fit as a linear problem about where it ended."""
        x, w = self.vector(fit), self._weights(EXACT)
        carried = self._carried(self.build(x))
        state, fundamental = self._state(x, EXACT, w, carried), [o.fundamental for o in self.observations]
        effects = self._effect_columns(state, EXACT, w, carried, range(len(self.scale)))
        columns = [
            np.concatenate([self._nuisance_columns(state.rig, o, False) * w_[:, f, :, None], E[:, f]], axis=-1)
            for o, w_, E, f in zip(self.observations, w, effects, fundamental, strict=True)
        ]
        residuals = [r[:, f] for r, f in zip(state.residuals, fundamental, strict=True)]
        return Linearised(w, residuals, columns, self.prior @ (self._centre - x))

    def within_floor(self, fit: Fit, stage: Stage) -> bool:
        """Whether a stage with a floor of its own would find a fit of this problem good enough."""
        x = self.vector(fit)
        return _within_floor(self._state(x, stage, self._weights(stage), self._carried(self.build(x))), stage)

    def residuals(self, fit: Fit) -> list[Complex]:
        """Weighted residuals of a fit of this part, (P, H, n) per sweep."""
        nothing: Carried = [None] * len(self.observations)
        return self._state(self.vector(fit), EXACT, self._weights(EXACT), nothing).residuals


def _within(hessian: Real, pull: Real, lowest: Mask, highest: Mask) -> Real:
    """Newton step of the values that are not at a bound that the step would cross, the others held there.

    Only clipped, such a value would leave the others short of where they are best with it at its bound, and the fit
    would crawl (projected Newton: Bertsekas, SIAM J. Control Optim. 20, 1982).
    """
    free = np.ones(len(pull), dtype=bool)
    while True:
        step = np.zeros(len(pull))
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], pull[free])
        outward = free & ((lowest & (step < 0)) | (highest & (step > 0)))
        if not outward.any():
            return step
        free &= ~outward


def _within_floor(state: _State, stage: Stage) -> bool:
    return stage.relative_floor > 0 and state.cost < WITHIN_FLOOR * state.size
