"""Uneven effects: stronger on one bearing, plane or axis than on another.

Of sensors, magnets and amplifiers there is one per axis, and one alone may be faulty. Few rigs need that, and the
imbalance parameters of every law would cost all of them time. So a regression first estimates each axis's share of an
effect, whose response is nearly the sum of its responses in each axis alone; only promising explanations are fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.evidence import prior_precision
from service.gap.fitting.fit import Problem
from service.gap.fitting.jacobian import stacked
from service.gap.fitting.part import Ground
from service.gap.fitting.predict import centred
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import TOLERANCE_BOUND, dormant_at_null
from service.gap.weighing.ranking import noise_levels
from service.gap.which.one_more_effect import rough_stages
from service.gap.which.refits import cost
from sim import imbalance
from sim.effect import Effect
from sim.effects import CATALOGUE
from sim.errors import AmbError
from sim.rig import Rig

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

PROMISING = 0.5
"""Share of the best explanation's excess chi-square that the regression must predict at most, for a fit to be tried."""
TRIED = 3
"""Number of the most promising ones that are fitted: among aliases the second may be right."""
HINTED = 0.02
"""Share of the gap that an effect must explain as an even one for the regression to be tried. One that is on one of
four axes explains a quarter, but nuisance values explain most of that as well (8 % remained to even eddy currents
where one magnet had them)."""


@dataclass(frozen=True)
class _Promise:
    """The predicted cost of an explanation once one of its effects is uneven, and the task to fit it."""

    cost: float
    task: Task


def with_uneven_effects(fitter: Fitter, ground: Ground, null: Candidate, found: Sequence[Candidate]) -> list[Candidate]:
    """Explanations of ``found`` with an uneven effect, where that leaves far less than any of these.

    ``null`` is the plain twin.
    """
    noise = sum(noise_levels(null, found))
    hinted = [c for c in found if cost(null) - cost(c) > HINTED * (cost(null) - noise)]
    asked = [(ground, c, name) for c in hinted for name in _may_be_uneven(c)]
    if not asked:
        return []
    best = min(found, key=cost)
    most = noise + PROMISING * max(cost(best) - noise, 0.0)
    promises = [p for p in fitter.over(_promise_or_none, asked) if p is not None and p.cost < most]
    tasks = [p.task for p in sorted(promises, key=lambda p: p.cost)[:TRIED]]
    return [c for c in fitter.run(tasks) if cost(c) < cost(best)]


def on_one_side(ground: Ground, c: Candidate) -> Iterator[Task]:
    """Tasks to fit an explanation with one effect at one bearing or in one plane alone, from the datasheet's values.

    Where these values made up for what the even effect has too much on one side, they are far from the right ones, and
    the regression of `with_uneven_effects` does not lead there.
    """
    for at, name in enumerate(c.effects):
        if name in _may_be_uneven(c):
            effect = CATALOGUE[name].of(ground.nuisance.rig)
            half = {**c.fit.values[at], **_scaled(effect, c.fit.values[at], 0.5)}  # of the mean of both sides
            sides = [{p: side} for p in _imbalances(effect, ground) for side in (1.0, -1.0)]
            starts = [tuple(half | one if k == at else v for k, v in enumerate(c.fit.values)) for one in sides]
            yield Task(ground, c.effects, tuple(starts), ground.theta, (*rough_stages(ground), EXACT))


def _imbalances(effect: Effect, ground: Ground) -> list[str]:
    return [p.name for p in effect.parameters if p.name in imbalance.NAMES][: ground.nuisance.rig.n_planes]


def _may_be_uneven(c: Candidate) -> list[str]:
    """Effects of an explanation that have dormant imbalances."""
    may = {name for name, p in dormant_at_null(c.effects, c.fit.values) if p in imbalance.NAMES}
    return [name for name in c.effects if name in may]


def _promise_or_none(asked: tuple[Ground, Candidate, str]) -> _Promise | None:
    """`_promise`; None where a rig with these shares is impossible."""
    with suppress(AmbError, np.linalg.LinAlgError):
        return _promise(*asked)
    return None


def _promise(ground: Ground, c: Candidate, name: str) -> _Promise | None:
    """Non-negative least squares of each axis's share of the effect ``name``; None where all shares are zero.

    At the excited frequency. The effect's own columns are replaced by its responses in each axis alone; nuisance values
    and the other effects are refitted to first order, under their priors.
    """
    at, effect, problem = c.effects.index(name), CATALOGUE[name].of(ground.nuisance.rig), Problem.of(ground, c.fit)
    values, without, linear = c.fit.values[at], _without(name, ground, c), problem.linearised(c.fit)
    imbalances = _imbalances(effect, ground)
    corners = np.array(list(product((1.0, -1.0), repeat=len(imbalances))))  # each is the effect in one axis alone
    one_axis = _scaled(effect, values, 1 / len(corners))
    rigs = [effect.on(without, **one_axis, **dict(zip(imbalances, corner, strict=True))) for corner in corners.tolist()]

    begin = len(problem.unknowns.active) + sum(len(CATALOGUE[e].parameters) for e in c.effects[:at])
    beside = np.r_[0:begin, begin + len(effect.parameters) : len(linear.pull)]
    changes = [_changes(problem, [*rigs, c.fit.rig], without, k, w) for k, w in enumerate(linear.weights)]
    residuals = np.concatenate([stacked(r[..., None])[:, 0] for r in linear.residuals])
    left = residuals + np.concatenate([change[:, -1] for change in changes])  # without the effect
    alone = np.concatenate([change[:, :-1] for change in changes])

    # the priors of the other unknowns are further rows
    root = np.linalg.cholesky(prior_precision(problem.unknowns)[np.ix_(beside, beside)]).T
    pull = np.linalg.solve(root.T, linear.pull[beside])
    known = np.concatenate([*(stacked(J[..., beside]) for J in linear.columns), root])
    left, alone = np.concatenate([left, pull]), np.concatenate([alone, np.zeros((len(beside), len(corners)))])
    basis, _ = np.linalg.qr(known)
    shares, root_left = scipy.optimize.nnls(alone - basis @ (basis.T @ alone), left - basis @ (basis.T @ left))
    if not shares.any():
        return None
    expected = cost(c) + root_left**2 - float(residuals @ residuals + pull @ pull)

    moved, theta = np.linalg.lstsq(known, left - alone @ shares)[0][: len(problem.unknowns.active)], c.fit.theta.copy()
    theta[problem.unknowns.active] = np.clip(theta[problem.unknowns.active] + moved, -TOLERANCE_BOUND, TOLERANCE_BOUND)
    shapes = dict(zip(imbalances, shares @ corners / shares.sum(), strict=True))
    if len(imbalances) > 1 and any(p.name == imbalance.DIAGONAL for p in effect.parameters):
        axes = [("x" if plane > 0 else "y") + ("A" if end > 0 else "B") for end, plane in corners]
        shapes = imbalance.of_shares(dict(zip(axes, shares.tolist(), strict=True)))
    start = _scaled(effect, values, shares.mean()) | shapes
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
    """Weighted responses of some rigs less that of the rig without, at the excited frequency, (2 P n, rigs)."""
    o = problem.observations[sweep]
    base = problem.model.predict(without, o, closed=False)
    changes = [centred(problem.model.predict(rig, o, closed=False) - base, weight, o) * weight for rig in rigs]
    return stacked(np.stack([change[:, o.fundamental] for change in changes], axis=-1))


def _scaled(effect: Effect, values: Mapping[str, float], share: float) -> dict[str, float]:
    """An effect's parameters without its imbalances, its strengths and amounts multiplied by ``share``."""
    return {
        p.name: float(np.clip(values[p.name] * share, p.low, p.high)) if p.strength or p.amount else values[p.name]
        for p in effect.parameters
        if p.name not in (*imbalance.NAMES, imbalance.DIAGONAL)
    }
