"""What a fit minimises in one of its stages: weighted residuals of a part's signal, and the price of its unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import stacked
from service.gap.fitting.part_model import Carried, PartModel
from service.gap.fitting.predict import centred, measured_signal, weight
from service.gap.fitting.stage import Stage
from service.gap.measured.observation import Observation
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

WITHIN_FLOOR = 0.02
"""Cost per residual from which a stage with a floor of its own hands over: 0.14 of the floor, root mean square."""


@dataclass(frozen=True)
class State:
    """Where a fit stands."""

    x: Real
    """(a + e,) the unknowns"""
    rig: Rig
    residuals: list[Complex]
    """weighted, (P, H, n) per sweep"""
    predictions: list[Complex]
    """(P, H, n) per sweep"""
    carried: Carried
    """what the predictions carry of the magnets' nonlinearity"""
    cost: float
    """chi-square of the residuals and the price of the unknowns"""

    @property
    def size(self) -> int:
        """Number of residuals, real and imaginary parts apart."""
        return sum(2 * r.size for r in self.residuals)


class Objective:
    """A part's model held against its measured signal with the weights of a stage."""

    def __init__(self, model: PartModel, stage: Stage) -> None:
        """The weights are those of the noise, with the stage's own floor beside it where it has one."""
        self.model, self.unknowns, self.stage = model, model.unknowns, stage
        self.weights = [self._weight(o) for o in model.observations]
        """1 / sd of real and imaginary part, (P, H, n) per sweep"""

    def _weight(self, o: Observation) -> Real:
        w = weight(o, self.model.signal)
        if not self.stage.relative_floor:
            return w
        size = np.abs(measured_signal(o, self.model.signal)[:, o.fundamental]).max(axis=1)
        floor = self.stage.relative_floor * size[:, None, None]
        return np.where(w > 0, 1 / np.hypot(1 / np.maximum(w, 1e-300), floor), 0.0)

    def begun(self, x: Real) -> State:
        """The state at ``x``, (a + e,), with what its own rig's nonlinearity adds."""
        return self.state(x, self.model.carried(self.unknowns.build(x)))

    def state(self, x: Real, carried: Carried) -> State:
        """The state at ``x``, (a + e,), with what is carried of the magnets' nonlinearity."""
        rig, model = self.unknowns.build(x), self.model
        predictions = [
            model.predict(rig, o, self.stage.closed, c) for o, c in zip(model.observations, carried, strict=True)
        ]
        residuals = [
            centred(measured_signal(o, model.signal) - p, w, o) * w
            for o, p, w in zip(model.observations, predictions, self.weights, strict=True)
        ]
        cost = float(sum(np.vdot(r, r).real for r in residuals)) + self.unknowns.penalty(x)
        return State(x, rig, residuals, predictions, carried, cost)

    def within_floor(self, state: State) -> bool:
        """Whether a stage with a floor of its own finds a state good enough."""
        return self.stage.relative_floor > 0 and state.cost < WITHIN_FLOOR * state.size

    def nuisance_columns(self, rig: Rig) -> list[Complex]:
        """Weighted derivatives of the fundamentals by the datasheet's values, (P, n, a) per sweep."""
        return [
            self.model.nuisance_columns(rig, o, self.stage.closed) * w[:, o.fundamental, :, None]
            for o, w in zip(self.model.observations, self.weights, strict=True)
        ]

    def nuisance_rows(self, rig: Rig) -> list[Real]:
        """`nuisance_columns` as real rows, (2 P n, a) per sweep."""
        return [stacked(columns) for columns in self.nuisance_columns(rig)]

    def effect_columns(self, state: State, of: range) -> list[Complex]:
        """Weighted derivatives by some of the effects' parameters, (P, H, n, len(of)) per sweep."""
        columns = self.model.effect_columns(state.x, state.predictions, of, self.stage.closed, state.carried)
        return [
            centred(column, w, o) * w[..., None]
            for column, w, o in zip(columns, self.weights, self.model.observations, strict=True)
        ]

    def normal_equations(self, state: State, rows: list[Real], columns: list[Complex]) -> tuple[Real, Real]:
        """J^T J, (a + e, a + e), and J^T r, (a + e,).

        The datasheet's values move only the fundamental, so only that is stacked for them.
        """
        a, m = self.unknowns.n_nuisance, len(state.x)
        curvature, gradient = np.zeros((m, m)), np.zeros(m)
        for o, r, J, E in zip(self.model.observations, state.residuals, rows, columns, strict=True):
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
