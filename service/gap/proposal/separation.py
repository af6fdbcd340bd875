"""Distance of two explanations' predictions of an experiment: T-optimal design (Atkinson and Fedorov 1975).

The experiment is taken to be diagnosed by itself, as it will be: the rival's nuisance values and the parameters of its
effects are refitted to what the other explanation predicts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from service.gap.fitting.candidates import LAW_ERROR, Candidate
from service.gap.fitting.jacobian import answer_jacobian
from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.predict import answer, centred, control, linear_answer, weights
from service.gap.fitting.unknowns import TOLERANCE_BOUND, slow_to_compute
from service.gap.measured.observation import Observation
from service.gap.proposal.options import Option
from sim.effect import Parameter
from sim.effects import CATALOGUE
from sim.errors import AmbError
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

INSIDE = 1e-9
"""Least range, in tolerances, of a nuisance value at its bound."""
STEP = 1e-3
"""Relative step of an effect's parameter for its derivative."""


def separations(nuisance: Nuisance, a: Candidate, b: Candidate, o: Observation, option: Option) -> tuple[float, float]:
    """Distances in standard deviations of an option's outcome: of b's best fit if a is true, and of a's if b is.

    They differ, as one may have more parameters to follow the other. The error of the true effect's law counts as
    noise, as `service.gap.weighing.alike.alike` does not distinguish two explanations that differ by no more.
    """
    one, other = (Predicted(nuisance, c, o, option) for c in (a, b))
    return _distance(one, other), _distance(other, one)


def _distance(truth: Predicted, rival: Predicted) -> float:
    """Residuals of the rival's best fit to the truth, in units of noise and of the law's error together."""
    shared = set(truth.candidate.effects) & set(rival.candidate.effects)
    plain = Predicted(truth.nuisance, _with_only(shared, truth), truth.o, truth.option)
    law_error = LAW_ERROR * left_over(truth, plain)
    return left_over(truth, rival) / float(np.hypot(1.0, law_error))


def _with_only(effects: Collection[str], p: Predicted) -> Candidate:
    """The twin of an explanation with some of its effects only."""
    kept = [k for k, name in enumerate(p.candidate.effects) if name in effects]
    names = tuple(p.candidate.effects[k] for k in kept)
    values = tuple(p.values[k] for k in kept)
    rig = p.nuisance.at(p.candidate.fit.theta)
    for name, own in zip(names, values, strict=True):
        rig = CATALOGUE[name].on(rig, **own)
    fit = replace(p.candidate.fit, effects=names, values=tuple(dict(v) for v in values), rig=rig)
    return replace(p.candidate, effects=names, fit=fit)


class Predicted:
    """An explanation's prediction of an option's outcome, [u, i, y] of all harmonics, (P, H, 3 n)."""

    def __init__(self, nuisance: Nuisance, c: Candidate, o: Observation, option: Option) -> None:
        self.nuisance, self.candidate, self.o, self.option = nuisance, c, o, option
        self.values: list[Mapping[str, float]] = [dict(v) for v in c.fit.values]
        self.rig = option.rig(c.fit.rig)
        self.now = self._of(self.rig)

    def _of(self, rig: Rig) -> Complex:
        return np.concatenate([control(rig, self.o), answer(rig, self.o)], axis=2)

    def at(self, theta: Real, values: Sequence[Mapping[str, float]]) -> Complex:
        """The prediction with other nuisance values and parameters of effects."""
        return self._of(self._rig(theta, values))

    def small_signal(self, theta: Real, values: Sequence[Mapping[str, float]]) -> Complex:
        """The same without what the magnets' nonlinearity makes of i and y, which takes long to compute."""
        rig, f, n = self._rig(theta, values), self.o.fundamental, self.nuisance.rig.n_axes
        u = control(rig, self.o)
        out = np.concatenate([u, np.zeros((*u.shape[:2], 2 * n), dtype=complex)], axis=2)
        out[:, f, n:] = linear_answer(rig, self.o)
        return out

    def _rig(self, theta: Real, values: Sequence[Mapping[str, float]]) -> Rig:
        rig = self.nuisance.at(theta)
        for name, own in zip(self.candidate.effects, values, strict=True):
            rig = CATALOGUE[name].on(rig, **own)
        return self.option.rig(rig)


def left_over(truth: Predicted, rival: Predicted) -> float:
    """Norm of the weighted residuals of a rival's best fit to the truth: bounded linear least squares.

    It is linearised at the nuisance values of the truth, as the derivatives with respect to them are of the fundamental
    only. Priors are those of a fit.
    """
    o, theta = truth.o, truth.candidate.fit.theta
    here = rival.at(theta, rival.values)
    w = weights(o)
    if truth.option.offset and 0 in o.harmonics:
        w[:, o.harmonics.index(0)] = 0.0  # a set-point moved by hand is not known well enough to judge means
    z = truth.now - rival.now - (here - rival.at(rival.candidate.fit.theta, rival.values))
    z = centred(z, w, o) * w
    effects, widths = _effect_columns(rival, theta, here, w)
    n, f, k = rival.nuisance.rig.n_axes, o.fundamental, len(rival.nuisance)
    J = np.zeros((*w.shape, k + effects.shape[-1]), dtype=complex)
    J[:, f, n:, :k] = answer_jacobian(rival.nuisance, rival.rig, o) * w[:, f, n:, None]
    J[..., k:] = effects
    rows = J.reshape(-1, J.shape[-1])
    rows = np.concatenate([rows.real, rows.imag])
    target = np.concatenate([z.real.ravel(), z.imag.ravel()])
    prior = np.diag(np.concatenate([np.ones(k), 12 / np.maximum(widths, 1e-12) ** 2]))  # uniform ones by their variance
    root = np.linalg.cholesky(prior + rows.T @ rows)
    explained = np.linalg.solve(root, rows.T @ target)
    # Nuisance values have the bounds of a fit.
    free = np.full(len(widths), np.inf)
    low = np.concatenate([np.minimum(-TOLERANCE_BOUND - theta, -INSIDE), -free])
    high = np.concatenate([np.maximum(TOLERANCE_BOUND - theta, INSIDE), free])
    moved = np.linalg.solve(root.T, explained)
    if not np.all((low <= moved) & (moved <= high)):  # the library takes a third of a second to load
        moved = scipy.optimize.lsq_linear(root.T, explained, (low, high), method="bvls").x
    left = float(target @ target) - float(explained @ explained) + float(np.sum((root.T @ moved - explained) ** 2))
    return float(np.sqrt(max(left, 0.0)))


def _effect_columns(c: Predicted, theta: Real, here: Complex, w: Real) -> tuple[Complex, Real]:
    """Weighted derivatives with respect to effect parameters, (P, H, 3 n, e), and the widths of their ranges, (e,).

    Per relative change with a log scale, else per width of the range. As a linear effect changes, the magnets'
    nonlinearity stays what it is.
    """
    columns, widths = [], []
    small = c.small_signal(theta, c.values)
    for k, name in enumerate(c.candidate.effects):
        of, before = (c.at, here) if slow_to_compute(name) else (c.small_signal, small)
        for p in CATALOGUE[name].of(c.nuisance.rig).parameters:
            moved, step, width = _moved(p, c.values[k].get(p.name, p.typical))
            changed = [*c.values[:k], {**c.values[k], p.name: moved}, *c.values[k + 1 :]]
            try:
                there = of(theta, changed)
            except AmbError:
                continue  # an impossible rig: this parameter stays
            columns.append(centred(there - before, w, c.o) * w / step)
            widths.append(width)
    if not columns:
        return np.zeros((*w.shape, 0), dtype=complex), np.zeros(0)
    return np.stack(columns, axis=-1), np.array(widths)


def _moved(p: Parameter, value: float) -> tuple[float, float, float]:
    """A parameter moved by a step, the step, and the width of its range in the same unit."""
    if p.scale == "log" and value > 0 and p.low > 0:
        inward = -1 if value * (1 + STEP) > p.high else 1
        return value * (1 + inward * STEP), inward * STEP, float(np.log(p.high / p.low))
    span = p.high - p.low
    inward = -1 if value + STEP * span > p.high else 1
    return value + inward * STEP * span, inward * STEP, 1.0
