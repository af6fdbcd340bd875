"""Maximum a posteriori fit of one part of the loop, with chosen effects, to observations: Levenberg-Marquardt.

Every candidate is fitted beside the datasheet's uncertain values, each under its tolerance as a unit-normal prior; an
effect's own parameters range freely between their bounds. Near the optimum the derivatives with respect to the
datasheet's values change little from step to step, so a stage may reuse them until a step fails with them (the chord
method).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import OUT_OF_STEPS, Fit, Linearised, TradeOff
from service.gap.fitting.objective import Objective, State
from service.gap.fitting.part import Ground
from service.gap.fitting.part_model import PartModel
from service.gap.fitting.stage import EXACT, Stage
from service.gap.fitting.unknowns import TOLERANCE_BOUND, Unknowns, dormant_at_null
from sim.effect import Effect
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

RENEWED, NOT_CHANGED = 4, 0.1
"""First steps after each of which the magnets' nonlinearity is recomputed, for effects that hardly change it, but for
those no longer than one that changed the cost so by less than this share of what ends the pass."""
NEAR = 0.05
"""Relative decrease of the cost that ends the steps of the datasheet's values alone with which a rough stage begins."""
SETTLING = 3
"""Gauss-Newton steps of the datasheet's values alone, before the parameters of a force law are fitted."""
TRIALS, TRIALS_WITH_REUSED = 7, 2
"""Dampings tried for a step with new derivatives, and with reused ones, which are renewed when none of them helps."""
DAMPING, LEAST_DAMPING, LEAST_AFTER_FAILURE = 1e-3, 1e-9, 1e-6
"""Share of the Hessian's diagonal added to it: at first, at least, and at least once a step has failed."""
IDLE = 1.0
"""Chi-square that the longest step of a value must predict at least, for it to be moved: a law of higher order in a
strength, as of saturation by flux, has no derivative at zero, and a step by its rounding errors would go anywhere."""


class Problem:
    """Observations of a part of the loop, its uncertain values, and the effects that are fitted beside them."""

    def __init__(
        self,
        ground: Ground,
        effects: Sequence[Effect] = (),
        held: Collection[tuple[str, str]] = (),
        found: Sequence[Mapping[str, float]] = (),
    ) -> None:
        """``held`` and ``found`` as of `Unknowns`."""
        self.ground, self.observations = ground, ground.observations
        self.unknowns = Unknowns(ground, effects, held, found)
        self.model = PartModel(self.unknowns)

    @classmethod
    def of(cls, ground: Ground, fit: Fit) -> Problem:
        """The problem that a fit has solved; only dormant parameters are held at their null."""
        effects = [CATALOGUE[name] for name in fit.effects]
        return cls(ground, effects, dormant_at_null(fit.effects, fit.values), fit.values)

    def run(self, x: Real, stage: Stage) -> Fit:
        """One Levenberg-Marquardt pass from ``x``, (a + e,).

        For an impossible rig it raises what the model does (`sim.errors.AmbError`, `numpy.linalg.LinAlgError`).
        """
        objective, damping, status = Objective(self.model, stage), DAMPING, OUT_OF_STEPS
        if stage.approach and self.model.nonlinear:
            x = self._approached(objective, x)
        state = objective.state(x, self.model.rough_nonlinearity(x)) if stage.closed else objective.fresh_state(x)
        derivatives, curvature = _Derivatives(objective), np.zeros((len(x), len(x)))
        still, renewed_at = 0.0, x  # a move that changed the nonlinearity by nothing that counts
        renews = RENEWED if self.model.signal == "y" and not self.model.nonlinear and not stage.closed else 0
        for iteration in range(stage.iterations):
            curvature, gradient = derivatives.normal_equations(state)
            trials = TRIALS if derivatives.new else TRIALS_WITH_REUSED
            found, damping = self._step(objective, state, curvature, gradient, damping, trials)
            if found is None and derivatives.new:
                status = "no step lowers the cost"
                break
            if found is None:
                derivatives.renew()
                damping = DAMPING
                continue
            damping = max(damping / 10, LEAST_DAMPING)
            drop, state = state.cost - found.cost, found
            moved = float(np.abs(state.x - renewed_at).max())
            if iteration < renews and moved > still:
                state, renewed_at = objective.fresh_state(state.x), state.x
                if abs(state.cost - found.cost) < NOT_CHANGED * stage.negligible(state.cost, objective.noise):
                    still = moved
            if objective.done(state, drop):
                status = "converged"
                break
        return self._fit(objective, state, curvature, status)

    def _approached(self, objective: Objective, x: Real) -> Real:
        """``x`` with the datasheet's values fitted while the magnets' nonlinearity stays what it is at the start.

        They have the farthest to go, and to compute the nonlinearity is what takes long. With it in every step from the
        datasheet's values on, a fit takes twice as long, and is drawn to where the effect vanishes.
        """
        rig, n_own, damping = self.unknowns.build(x), len(x) - self.unknowns.n_nuisance, DAMPING
        state = objective.state(x, [self.model.beyond_linear(rig, o) for o in self.observations])
        for _ in range(objective.stage.approach):
            held = [np.zeros((*p.shape, n_own), dtype=complex) for p in state.predictions]
            curvature, gradient = objective.normal_equations(state, objective.nuisance_rows(state.rig), held)
            found, damping = self._step(objective, state, curvature, gradient, damping, TRIALS)
            if found is None:
                break
            damping = max(damping / 10, LEAST_DAMPING)
            drop, state = state.cost - found.cost, found
            if drop < NEAR * state.cost:
                break
        return state.x

    def _step(
        self, objective: Objective, state: State, curvature: Real, gradient: Real, damping: float, trials: int
    ) -> tuple[State | None, float]:
        """The first state of lower cost, as the damping of the step is raised, and that damping; or None."""
        low, high, longest = self.unknowns.bounds()
        hessian = curvature + self.unknowns.prior
        scale = np.diag(np.maximum(np.diag(hessian), 1e-12))
        pull = gradient - self.unknowns.prior @ (state.x - self.unknowns.prior_mean)
        idle = np.diag(hessian) * longest**2 < IDLE
        for _ in range(trials):
            step = _within(hessian + damping * scale, pull, ~idle, state.x <= low, state.x >= high)
            x = np.clip(state.x + np.clip(step, -longest, longest), low, high)
            found = objective.state(x, state.nonlinearity)
            if np.isfinite(found.cost) and found.cost < state.cost:
                return found, damping
            damping = max(damping * 10, LEAST_AFTER_FAILURE)
        return None, damping

    def settled(self, x: Real) -> tuple[float, Real]:
        """Cost and ``x`` after a few Gauss-Newton steps of the datasheet's values, effects' parameters held.

        It makes the starts of a force law comparable: far from its optimum, stiffnesses and gains must change much
        first.
        """
        a, prior, objective = self.unknowns.n_nuisance, self.unknowns.prior, Objective(self.model, EXACT)
        state = objective.fresh_state(x)
        for _ in range(SETTLING):
            no_effects = [np.zeros((*p.shape, len(x) - a), dtype=complex) for p in state.predictions]
            curvature, gradient = objective.normal_equations(state, objective.nuisance_rows(state.rig), no_effects)
            hessian, pull = (curvature + prior)[:a, :a], (prior @ (state.x - self.unknowns.prior_mean))[:a]
            moved = state.x.copy()
            moved[:a] += np.linalg.solve(hessian, gradient[:a] - pull)
            moved[:a] = np.clip(moved[:a], -TOLERANCE_BOUND, TOLERANCE_BOUND)
            trial = objective.fresh_state(moved)
            if not trial.cost < state.cost:
                break
            state = trial
        return state.cost, state.x

    def _fit(self, objective: Objective, state: State, curvature: Real, status: str) -> Fit:
        """The result of a pass that ended in ``state``."""
        groups: list[tuple[float, int]] = []
        across: list[tuple[float, int]] = []

        def chi_square(r: Complex, w: Real) -> tuple[float, int]:
            return float(np.sum(np.abs(r) ** 2)), 2 * int((w > 0).sum())

        for o, r, w in zip(self.observations, state.residuals, objective.weights, strict=True):
            fundamental = np.arange(len(o.harmonics)) == o.fundamental
            groups += [chi_square(r[:, chosen], w[:, chosen]) for chosen in (fundamental, ~fundamental)]
            other_plane = np.arange(r.shape[2]) // 2 != o.axis[:, None] // 2
            across.append(chi_square(r[:, o.fundamental][other_plane], w[:, o.fundamental][other_plane]))
        e, n = state.x[self.unknowns.n_nuisance :], len(self.unknowns.effects)
        values = self.unknowns.values(e)
        return Fit(
            effects=tuple(effect.id for effect in self.unknowns.effects),
            theta=self.unknowns.theta(state.x),
            values=values[:n],
            rig=state.rig,
            groups=tuple(groups),
            penalty=self.unknowns.price(state.x),
            active=self.unknowns.active,
            curvature=curvature,
            status=status,
            inherited=values[n:],
            across=tuple(across),
            ends=self.unknowns.ends(e),
            trade_off=self._trade_off(state.x, curvature),
        )

    def _trade_off(self, x: Real, curvature: Real) -> TradeOff:
        """Of chi-square and penalty about ``x``; nuisance values at their bounds are held."""
        u, free = self.unknowns, np.ones(len(x), dtype=bool)
        free[: u.n_nuisance] = np.abs(x[: u.n_nuisance]) < 0.999 * TOLERANCE_BOUND
        return TradeOff.at(x - u.prior_mean, curvature, u.prior, free)

    def linearised(self, fit: Fit) -> Linearised:
        """The fit as a linear least-squares problem about its solution."""
        x, objective = self.unknowns.vector(fit), Objective(self.model, EXACT)
        state = objective.fresh_state(x)
        nuisance = objective.nuisance_columns(state.rig)
        effects = objective.effect_columns(state, range(len(self.unknowns.scale)))
        fundamental = [o.fundamental for o in self.observations]
        return Linearised(
            objective.weights,
            [r[:, f] for r, f in zip(state.residuals, fundamental, strict=True)],
            [np.concatenate([J, E[:, f]], axis=-1) for J, E, f in zip(nuisance, effects, fundamental, strict=True)],
            self.unknowns.prior @ (self.unknowns.prior_mean - x),
        )

    def within_floor(self, fit: Fit, stage: Stage) -> bool:
        """Whether the residuals of a fit are small beside the floor of a rough stage."""
        objective = Objective(self.model, stage)
        return objective.within_floor(objective.fresh_state(self.unknowns.vector(fit)))

    def left_by(self, fit: Fit, stage: Stage) -> float:
        """What the ``fit`` in which a pass of a stage ended leaves beyond noise and the stage's floor, per residual."""
        return (fit.cost - Objective(self.model, stage).noise) / fit.n_residuals

    def residuals(self, fit: Fit) -> list[Complex]:
        """Weighted residuals of a fit of this part, (P, H, n) per sweep."""
        return Objective(self.model, EXACT).state(self.unknowns.vector(fit), [None] * len(self.observations)).residuals


class _Derivatives:
    """Derivatives along a fit; those with respect to nuisance and inherited values are reused for a stage's chord."""

    def __init__(self, objective: Objective) -> None:
        self._objective, n_own = objective, objective.unknowns.n_own
        self._own, self._inherited = range(n_own), range(n_own, len(objective.unknowns.scale))
        self._nuisance_rows: list[Real] = []
        self._inherited_columns: list[Complex] = []
        self._age = objective.stage.chord

    @property
    def new(self) -> bool:
        """Whether all derivatives of the last call were computed at its own state."""
        return self._age == 1

    def renew(self) -> None:
        """Recompute all at the next call."""
        self._age = self._objective.stage.chord

    def normal_equations(self, state: State) -> tuple[Real, Real]:
        """J^T J, (a + e, a + e), and J^T r, (a + e,)."""
        if self._age >= self._objective.stage.chord:
            self._nuisance_rows, self._age = self._objective.nuisance_rows(state.rig), 0
            self._inherited_columns = self._objective.effect_columns(state, self._inherited)
        self._age += 1
        own = self._objective.effect_columns(state, self._own)
        columns = [np.concatenate(both, axis=-1) for both in zip(own, self._inherited_columns, strict=True)]
        return self._objective.normal_equations(state, self._nuisance_rows, columns)


def _within(hessian: Real, pull: Real, movable: Mask, lowest: Mask, highest: Mask) -> Real:
    """Projected Newton step (Bertsekas, SIAM J. Control Optim. 20, 1982): values at a bound do not cross it.

    Only ``movable`` values move, (a + e,). Those at a bound are held and the step of the others is solved for again. If
    the full step were clipped instead, the others would miss their optimum with that value at its bound, and the fit
    would converge slowly.
    """
    free = movable.copy()
    while True:
        step = np.zeros(len(pull))
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], pull[free])
        outward = free & ((lowest & (step < 0)) | (highest & (step > 0)))
        if not outward.any():
            return step
        free &= ~outward
