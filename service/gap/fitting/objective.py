"""The objective of a fit's stage: chi-square of a part's weighted residuals, and the penalty of its unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import stacked
from service.gap.fitting.part_model import Nonlinearity, PartModel
from service.gap.fitting.predict import centred, measured_signal, weight
from service.gap.fitting.stage import Stage
from service.gap.measured.observation import Observation
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

WITHIN_FLOOR, STILL_FALLING = 0.05, 1.5e-3
"""Cost per residual, beyond that of noise, below which a stage with a floor of its own is done: what is left is 0.22 of
the floor, rms. Not while a step lowers it by more than the second: the stage still walks along a valley, in which the
next one, whose residuals are mostly noise, would end too early."""


@dataclass(frozen=True)
class State:
    """A vector of unknowns with its rig, predictions, residuals and cost."""

    x: Real
    """(a + e,) the unknowns"""
    rig: Rig
    residuals: list[Complex]
    """weighted, (P, H, n) per sweep"""
    predictions: list[Complex]
    """(P, H, n) per sweep"""
    nonlinearity: Nonlinearity
    """of the magnets, as it is in the predictions; it may be of another vector nearby, in a rough stage of its start"""
    cost: float
    """chi-square of the residuals and penalty of the unknowns"""

    @property
    def size(self) -> int:
        """Number of residuals, real and imaginary parts apart."""
        return sum(2 * r.size for r in self.residuals)


class Objective:
    """Compares a part's model with its measured signal, with the weights of a stage."""

    def __init__(self, model: PartModel, stage: Stage) -> None:
        """Weights are those of the noise, combined with the stage's own floor where it has one."""
        self.model, self.unknowns, self.stage = model, model.unknowns, stage
        of_noise = [weight(o, model.signal) for o in model.observations]
        self.weights = [self._weight(o, w) for o, w in zip(model.observations, of_noise, strict=True)]
        """1 / sd of real and imaginary part, (P, H, n) per sweep"""
        self.noise = sum(_noise(w, exact) for w, exact in zip(self.weights, of_noise, strict=True))
        """cost that noise alone is expected to have: the number of real values, where a stage has no floor"""

    def _weight(self, o: Observation, w: Real) -> Real:
        if not self.stage.relative_floor:
            return w
        size = np.abs(measured_signal(o, self.model.signal)[:, o.fundamental]).max(axis=1)
        floor = self.stage.relative_floor * size[:, None, None]
        return np.where(w > 0, 1 / np.hypot(1 / np.maximum(w, 1e-300), floor), 0.0)

    def fresh_state(self, x: Real) -> State:
        """The state at ``x``, (a + e,), with the magnets' nonlinearity computed there."""
        return self.state(x, self.model.nonlinearity(self.unknowns.build(x)))

    def state(self, x: Real, nonlinearity: Nonlinearity) -> State:
        """The state at ``x``, (a + e,), with a given nonlinearity of the magnets."""
        rig, model = self.unknowns.build(x), self.model
        predictions = [
            model.predict(rig, o, self.stage.closed, c) for o, c in zip(model.observations, nonlinearity, strict=True)
        ]
        residuals = [
            centred(measured_signal(o, model.signal) - p, w, o) * w
            for o, p, w in zip(model.observations, predictions, self.weights, strict=True)
        ]
        cost = float(sum(np.vdot(r, r).real for r in residuals)) + self.unknowns.penalty(x)
        return State(x, rig, residuals, predictions, nonlinearity, cost)

    def done(self, state: State, drop: float) -> bool:
        """Whether a stage ends in a state that a step led to which lowered the cost by ``drop``."""
        if drop < self.stage.negligible(state.cost, self.noise):
            return True
        return drop < STILL_FALLING * state.size and self.within_floor(state)

    def within_floor(self, state: State) -> bool:
        """Whether the residuals are small beside the stage's own floor."""
        return self.stage.relative_floor > 0 and state.cost - self.noise < WITHIN_FLOOR * state.size

    def nuisance_columns(self, rig: Rig) -> list[Complex]:
        """Weighted derivatives of the fundamentals with respect to the nuisance values, (P, n, a) per sweep."""
        return [
            self.model.nuisance_columns(rig, o, self.stage.closed) * w[:, o.fundamental, :, None]
            for o, w in zip(self.model.observations, self.weights, strict=True)
        ]

    def nuisance_rows(self, rig: Rig) -> list[Real]:
        """`nuisance_columns` as real rows, (2 P n, a) per sweep."""
        return [stacked(columns) for columns in self.nuisance_columns(rig)]

    def effect_columns(self, state: State, of: range) -> list[Complex]:
        """Weighted derivatives with respect to some effect parameters ``of``, (P, H, n, len(of)) per sweep."""
        columns = self.model.effect_columns(state.x, state.predictions, of, self.stage.closed, state.nonlinearity)
        return [
            centred(column, w, o) * w[..., None]
            for column, w, o in zip(columns, self.weights, self.model.observations, strict=True)
        ]

    def normal_equations(self, state: State, rows: list[Real], columns: list[Complex]) -> tuple[Real, Real]:
        """J^T J, (a + e, a + e), and J^T r, (a + e,), without the prior.

        Derivatives of other harmonics with respect to nuisance values are neglected.
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


def _noise(weights: Real, of_noise: Real) -> float:
    """Cost of noise alone: a share of every real value, the smaller, the more error a stage allows beside it."""
    share = np.divide(weights, of_noise, out=np.zeros_like(weights), where=of_noise > 0)
    return float(2 * np.sum(share**2))
