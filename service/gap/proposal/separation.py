"""How far apart two explanations predict an experiment's outcome: T-optimal design (Atkinson and Fedorov 1975).

The experiment is diagnosed on its own, as it will be: the values that the datasheet leaves open, and the parameters of
the rival's own effects, may move to follow what the other explanation brings about.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import LAW_ERROR, Candidate
from service.gap.fitting.jacobian import answer_jacobian
from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.predict import answer, centred, control, weights
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.measured.observation import Observation
from service.gap.proposal.options import Option
from sim.effect import Parameter
from sim.effects import CATALOGUE
from sim.errors import AmbError
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

INSIDE = 1e-9
"""Tolerances that a value at its end has still to move."""
STEP = 1e-3
"""Of an effect's parameter, relative, for its derivative."""


def separations(nuisance: Nuisance, a: Candidate, b: Candidate, o: Observation, option: Option) -> tuple[float, float]:
    """Distances in standard deviations of an option's outcome: what b leaves where a is true, and a where b is.

    They differ where one has more ways to follow the other. What another law of the true effect may leave as well is
    uncertain like noise: `service.gap.weighing.verdict.alike` leaves two together that differ by no more.
    """
    one, other = (Predicted(nuisance, c, o, option) for c in (a, b))
    return _told(one, other), _told(other, one)


def _told(truth: Predicted, rival: Predicted) -> float:
    """What a rival leaves of the truth, in units of noise and of the error of the true effect's own law together."""
    shared = set(truth.candidate.effects) & set(rival.candidate.effects)
    plain = Predicted(truth.nuisance, _with_only(shared, truth), truth.o, truth.option)
    of_law = LAW_ERROR * left_over(truth, plain)
    return left_over(truth, rival) / float(np.hypot(1.0, of_law))


def _with_only(effects: Collection[str], p: Predicted) -> Candidate:
    """The twin of an explanation with some of its effects alone."""
    kept = [k for k, name in enumerate(p.candidate.effects) if name in effects]
    names = tuple(p.candidate.effects[k] for k in kept)
    values = tuple(p.values[k] for k in kept)
    rig = p.nuisance.at(p.candidate.fit.theta)
    for name, own in zip(names, values, strict=True):
        rig = CATALOGUE[name].on(rig, **own)
    fit = replace(p.candidate.fit, effects=names, values=tuple(dict(v) for v in values), rig=rig)
    return replace(p.candidate, effects=names, fit=fit)


class Predicted:
    """What an explanation predicts of an option's outcome, [u, i, y] of all harmonics, (P, H, 3 n)."""

    def __init__(self, nuisance: Nuisance, c: Candidate, o: Observation, option: Option) -> None:
        self.nuisance, self.candidate, self.o, self.option = nuisance, c, o, option
        self.values: list[Mapping[str, float]] = [dict(v) for v in c.fit.values]
        self.rig = option.rig(c.fit.rig)
        self.now = self._of(self.rig)

    def _of(self, rig: Rig) -> Complex:
        return np.concatenate([control(rig, self.o), answer(rig, self.o)], axis=2)

    def at(self, theta: Real, values: Sequence[Mapping[str, float]]) -> Complex:
        """The same with other values of the datasheet and of the effects."""
        rig = self.nuisance.at(theta)
        for name, own in zip(self.candidate.effects, values, strict=True):
            rig = CATALOGUE[name].on(rig, **own)
        return self._of(self.option.rig(rig))


def left_over(truth: Predicted, rival: Predicted) -> float:
    """Norm of what a rival leaves of the truth, in units of its noise, once it has followed it.

    It starts from the true values of the datasheet: to follow them by derivatives takes the fundamental only.
    """
    from scipy.optimize import lsq_linear  # takes a while, and only what is left together needs it

    o, theta = truth.o, truth.candidate.fit.theta
    here = rival.at(theta, rival.values)
    w = weights(o)
    if truth.option.offset and 0 in o.harmonics:
        w[:, o.harmonics.index(0)] = 0.0  # a set-point moved by hand is not known so well that means could be judged
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
    known = np.diag(np.concatenate([np.ones(k), 12 / np.maximum(widths, 1e-12) ** 2]))  # of a uniform one, its variance
    root = np.linalg.cholesky(known + rows.T @ rows)
    taken = np.linalg.solve(root, rows.T @ target)
    # No fit takes the datasheet's values farther than this; an effect's parameters have ends of their own.
    free = np.full(len(widths), np.inf)
    low = np.concatenate([np.minimum(-TOLERANCE_BOUND - theta, -INSIDE), -free])
    high = np.concatenate([np.maximum(TOLERANCE_BOUND - theta, INSIDE), free])
    moved = lsq_linear(root.T, taken, (low, high), method="bvls").x
    left = float(target @ target) - float(taken @ taken) + float(np.sum((root.T @ moved - taken) ** 2))
    return float(np.sqrt(max(left, 0.0)))


def _effect_columns(c: Predicted, theta: Real, here: Complex, w: Real) -> tuple[Complex, Real]:
    """Weighted derivatives to the parameters of an explanation's effects, (P, H, 3 n, e), and widths of their ranges.

    Each in units of itself where it ranges over decades, else of its range.
    """
    columns, widths = [], []
    for k, name in enumerate(c.candidate.effects):
        for p in CATALOGUE[name].of(c.nuisance.rig).parameters:
            moved, step, width = _moved(p, c.values[k].get(p.name, p.typical))
            changed = [*c.values[:k], {**c.values[k], p.name: moved}, *c.values[k + 1 :]]
            try:
                there = c.at(theta, changed)
            except AmbError:
                continue  # no such rig: it cannot follow there
            columns.append(centred(there - here, w, c.o) * w / step)
            widths.append(width)
    if not columns:
        return np.zeros((*w.shape, 0), dtype=complex), np.zeros(0)
    return np.stack(columns, axis=-1), np.array(widths)


def _moved(p: Parameter, value: float) -> tuple[float, float, float]:
    """A parameter a little off, by how much, and the width of its range in the same unit."""
    if p.scale == "log" and value > 0 and p.low > 0:
        inward = -1 if value * (1 + STEP) > p.high else 1
        return value * (1 + inward * STEP), inward * STEP, float(np.log(p.high / p.low))
    span = p.high - p.low
    inward = -1 if value + STEP * span > p.high else 1
    return value + inward * STEP * span, inward * STEP, 1.0
