"""Model of a part of the loop: predictions of its output from its measured input, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.jacobian import current_jacobian, displacement_jacobian
from service.gap.fitting.predict import at_speed_of, beyond_linear, control, current, whole_displacement
from service.gap.fitting.unknowns import Unknowns, slow_to_compute
from service.gap.measured.observation import Observation
from sim.at_points import responses
from sim.rig import Rig
from sim.twin import LinearModel, linear_model, passing_model, small_signal

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Nonlinearity = Sequence[Complex | None]
"""What the magnets' nonlinearity adds to the small-signal displacement of each sweep, (P, H, n); None: to be computed
with each prediction, as a nonlinear effect is fitted."""

STEP = 2e-5
"""Step of forward differences of an effect's parameter, in units of its scale."""


class PartModel:
    """The model of a part of the loop: predictions of its signal in each sweep, and derivatives."""

    def __init__(self, unknowns: Unknowns) -> None:
        """Part, sweeps and effects are those of the unknowns."""
        self.unknowns, self.ground = unknowns, unknowns.ground
        self.observations, self.signal = self.ground.observations, self.ground.part.signal
        self.nonlinear = any(slow_to_compute(e.id) for e in unknowns.effects)
        self._rough: Nonlinearity | None = None

    def predict(self, rig: Rig, o: Observation, closed: bool, nonlinearity: Complex | None = None) -> Complex:
        """The part's output for its measured input, (P, H, n) in the unit of the signal.

        With ``closed`` the input is what the twin's own loop makes of the excitation. ``nonlinearity`` is what the
        magnets' nonlinearity adds to the small-signal displacement, (P, H, n); it hardly changes while a linear effect
        is fitted, so it is computed once for all rough stages of a fit, and a few times in the last one.
        """
        if self.signal == "u":
            return control(rig, o)
        if self.signal == "i":
            return current(rig, o)
        if nonlinearity is None and not closed:
            return whole_displacement(rig, o)
        out = self.beyond_linear(rig, o) if nonlinearity is None else nonlinearity.copy()
        out[:, o.fundamental] += self._small_signal(rig, o, closed)
        return out

    def nonlinearity(self, rig: Rig) -> Nonlinearity:
        """The nonlinearity of each sweep, for `predict`; None where a fitted effect changes it at every step."""
        return [None if self.nonlinear else self.beyond_linear(rig, o) for o in self.observations]

    def rough_nonlinearity(self, x: Real) -> Nonlinearity:
        """The nonlinearity for stages that allow an error: with the datasheet's values of the first ``x``, (a + e,).

        Without the part's own effects, which all starts of a fit have otherwise.
        """
        if self._rough is None:
            self._rough = self.nonlinearity(self.ground.rig(self.unknowns.theta(x)))
        return self._rough

    def beyond_linear(self, rig: Rig, o: Observation) -> Complex:
        """Displacement less its small-signal fundamental, (P, H, n); of other parts than the plant it is empty."""
        if self.signal != "y":
            return np.zeros((*o.U.shape[:2], 0), dtype=complex)
        return beyond_linear(rig, o)

    def nuisance_columns(self, rig: Rig, o: Observation, closed: bool) -> Complex:
        """Derivative of the fundamental with respect to the nuisance values that are fitted, (P, n, a)."""
        n, nuisance, active = rig.n_axes, self.ground.nuisance, self.unknowns.active
        if self.signal == "u":
            return np.zeros((len(o.line), n, 0), dtype=complex)
        if self.signal == "i":
            return current_jacobian(nuisance, rig, o)
        amplifiers = self.ground.part.from_control or self.ground.inherited is not None
        if not closed:
            return displacement_jacobian(nuisance, rig, o, amplifiers)[:, :, active]
        rig = _small(rig, o)
        model = linear_model(rig, o.frequency_hz)
        U = o.U.copy()
        U[:, o.fundamental] = self._closed_control(o, model)
        J = displacement_jacobian(nuisance, rig, replace(o, U=U), amplifiers)[:, :, active]
        C = (model.controllers / model.log_phase[:, None])[:, None, :]
        return np.asarray(np.linalg.inv(np.eye(n) + model.y_per_u * C)[o.line] @ J)

    def effect_columns(
        self, x: Real, predictions: Sequence[Complex], of: range, closed: bool, nonlinearity: Nonlinearity
    ) -> list[Complex]:
        """Derivatives of the ``predictions`` at ``x`` with respect to effect parameters, (P, H, n, len(of)) per sweep.

        ``of`` are their indices, counted from the first effect's first. Columns of held parameters are zero. As
        parameters of linear effects move, the magnets' nonlinearity stays what it is: a given one, and with ``closed``,
        which allows an error, any.
        """
        low, high, a = self.unknowns.low, self.unknowns.high, self.unknowns.n_nuisance
        columns = [np.zeros((*p.shape, len(of)), dtype=complex) for p in predictions]
        for column_of, j in enumerate(of):
            if low[j] == high[j]:
                continue
            moved, at = x.copy(), a + j
            moved[at] += STEP if moved[at] + STEP <= high[j] else -STEP
            rig, step = self.unknowns.build(moved), moved[at] - x[at]
            linear = self.signal == "y" and not self.unknowns.slow[j]
            for column, o, c, p in zip(columns, self.observations, nonlinearity, predictions, strict=True):
                f = o.fundamental
                if linear and (closed or c is not None):
                    here = self._small_signal(self.unknowns.build(x), o, closed) if c is None else (p - c)[:, f]
                    there = self._small_signal(rig, o, closed, passing_model)
                    column[:, f, :, column_of] = (there - here) / step
                else:
                    column[..., column_of] = (self.predict(rig, o, closed, c) - p) / step
        return columns

    def _small_signal(
        self, rig: Rig, o: Observation, closed: bool, model_of: Callable[[Rig, Real], LinearModel] = linear_model
    ) -> Complex:
        """Small-signal displacement, (P, n), for the measured control signal, or ``closed`` in the twin's own loop."""
        model = model_of(_small(rig, o), o.frequency_hz)
        return responses(model.y_per_u, o.line, self._closed_control(o, model) if closed else o.U[:, o.fundamental])

    def _closed_control(self, o: Observation, model: LinearModel) -> Complex:
        """Control signal, (P, n), of the twin's loop for the excitation u + C y.

        It is not r, so that an error of the controller does not appear as one of the plant. A logging offset is taken
        out before the loop is closed and is not part of it: with it the loop could be nearly unstable.
        """
        f = o.fundamental
        C, late = model.controllers[o.line], model.log_phase[o.line, None]
        excitation = late * o.U[:, f] + C * o.Y[:, f]
        return responses(model.u_per_r, o.line, excitation)


def _small(rig: Rig, o: Observation) -> Rig:
    """The rig at the speed of the observation, as small signals meet it: many that are tried differ in the rest."""
    return small_signal(at_speed_of(rig, o))
