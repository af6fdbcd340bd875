"""Effects that are on one bearing, plane or axis more than on another, where the same on all leaves much.

A sensor that is slow, a magnet that saturates: of what there is one of in each axis, one alone may be at fault. Few
rigs need that, and two more parameters of every law would cost all of them time. So the data are asked first which axes
have an effect: its answer is nearly the sum of those that it has in each axis alone, and a regression tells their
shares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.evidence import prior_precision
from service.gap.fitting.fit import Problem
from service.gap.fitting.jacobian import stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import centred
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import TOLERANCE_BOUND, asleep
from service.gap.weighing.ranking import noise_levels
from service.gap.which.refits import cost
from sim import imbalance
from sim.effect import Effect
from sim.effects import CATALOGUE
from sim.errors import AmbError
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PROMISING = 0.5
"""Share of what the best explanation leaves beyond noise that one must be expected to leave at most, to be fitted."""
TRIED = 3
"""Most promising ones that are fitted: of those that look alike, more than one may be it."""
HINTED = 0.02
"""Share of the plain twin's excess that an effect must explain where it is the same on all, to be asked for the axes:
one that is on one of four would explain a quarter, but the datasheet's values explain most of that as well (of eddy
currents of one magnet 8 % were left to the same on all)."""


@dataclass(frozen=True)
class _Promise:
    """What an explanation is expected to leave once one of its effects may differ from axis to axis."""

    cost: float
    task: Task


def with_uneven_effects(fitter: Fitter, ground: Ground, null: Candidate, found: Sequence[Candidate]) -> list[Candidate]:
    """Explanations of ``found`` with an effect that differs from axis to axis, where that leaves far less than any.

    ``null`` is the plain twin.
    """
    noise = sum(noise_levels(null, found))
    hinted = [c for c in found if cost(null) - cost(c) > HINTED * (cost(null) - noise)]
    asked = [(ground, c, name) for c in hinted for name in _uneven_by(c)]
    if not asked:
        return []
    best = min(found, key=cost)
    most = noise + PROMISING * max(cost(best) - noise, 0.0)
    promises = [p for p in fitter.over(_promise, asked) if p is not None and p.cost < most]
    tasks = [p.task for p in sorted(promises, key=lambda p: p.cost)[:TRIED]]
    return [c for c in fitter.run(tasks) if cost(c) < cost(best)]


def _uneven_by(c: Candidate) -> list[str]:
    """Effects of an explanation that may differ from axis to axis, and do not yet."""
    may = {name for name, p in asleep(c.effects, c.fit.values) if p in imbalance.NAMES}
    return [name for name in c.effects if name in may]


def _promise(asked: tuple[Ground, Candidate, str]) -> _Promise | None:
    """What an effect of an explanation would leave if each axis had its own share of it; None where none has any."""
    with suppress(AmbError, np.linalg.LinAlgError):  # at these shares there is no such rig
        return _asked(*asked)
    return None


def _asked(ground: Ground, c: Candidate, name: str) -> _Promise | None:
    """The same, at the excited frequency, the datasheet's values and the other effects following to first order."""
    at, effect, problem = c.effects.index(name), CATALOGUE[name].of(ground.nuisance.rig), Problem.of(ground, c.fit)
    values, without, linear = c.fit.values[at], _without(name, ground, c), problem.linearised(c.fit)
    shapes = [p.name for p in effect.parameters if p.name in imbalance.NAMES][: ground.nuisance.rig.n_planes]
    corners = np.array(list(product((1.0, -1.0), repeat=len(shapes))))
    one = _scaled(effect, values, 1 / len(corners))
    rigs = [effect.on(without, **one, **dict(zip(shapes, corner, strict=True))) for corner in corners.tolist()]

    begin = len(problem.unknowns.active) + sum(len(CATALOGUE[e].parameters) for e in c.effects[:at])
    beside = np.r_[0:begin, begin + len(effect.parameters) : len(linear.pull)]
    changes = [_changes(problem, [*rigs, c.fit.rig], without, k, w) for k, w in enumerate(linear.weights)]
    residuals = np.concatenate([stacked(r[..., None])[:, 0] for r in linear.residuals])
    left = residuals + np.concatenate([change[:, -1] for change in changes])  # without the effect
    alone = np.concatenate([change[:, :-1] for change in changes])

    # what is known of the values beside it counts as further data
    root = np.linalg.cholesky(prior_precision(problem.unknowns)[np.ix_(beside, beside)]).T
    pull = np.linalg.solve(root.T, linear.pull[beside])
    known = np.concatenate([*(stacked(J[..., beside]) for J in linear.columns), root])
    left, alone = np.concatenate([left, pull]), np.concatenate([alone, np.zeros((len(beside), len(corners)))])
    basis, _ = np.linalg.qr(known)
    shares, root_left = nnls(alone - basis @ (basis.T @ alone), left - basis @ (basis.T @ left))
    if not shares.any():
        return None
    expected = cost(c) + root_left**2 - float(residuals @ residuals + pull @ pull)

    moved, theta = np.linalg.lstsq(known, left - alone @ shares)[0][: len(problem.unknowns.active)], c.fit.theta.copy()
    theta[problem.unknowns.active] = np.clip(theta[problem.unknowns.active] + moved, -TOLERANCE_BOUND, TOLERANCE_BOUND)
    start = _scaled(effect, values, shares.mean()) | dict(zip(shapes, shares @ corners / shares.sum(), strict=True))
    starts = tuple(start if k == at else own for k, own in enumerate(c.fit.values))
    return _Promise(expected, Task(ground, c.effects, (starts,), theta, (EXACT,)))


def _without(name: str, ground: Ground, c: Candidate) -> Rig:
    """The rig of an explanation without one of its effects."""
    rig = ground.fitted_rig(c.fit.theta, c.fit.inherited)
    for other, values in zip(c.effects, c.fit.values, strict=True):
        if other != name:
            rig = CATALOGUE[other].on(rig, **values)
    return rig


def _changes(problem: Problem, rigs: Sequence[Rig], without: Rig, sweep: int, weight: Real) -> Real:
    """What each of some rigs answers beyond the one without, weighted, at the excited frequency, (2 P n, rigs)."""
    o = problem.observations[sweep]
    base = problem.model.predict(without, o, closed=False)
    answers = [centred(problem.model.predict(rig, o, closed=False) - base, weight, o) * weight for rig in rigs]
    return stacked(np.stack([answer[:, o.fundamental] for answer in answers], axis=-1))


def _scaled(effect: Effect, values: Mapping[str, float], share: float) -> dict[str, float]:
    """An effect's parameters without its imbalances, the strengths multiplied."""
    return {
        p.name: float(np.clip(values[p.name] * share, p.low, p.high)) if p.strength else values[p.name]
        for p in effect.parameters
        if p.name not in imbalance.NAMES
    }
