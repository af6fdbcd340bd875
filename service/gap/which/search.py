"""The explanations of one part of the loop: the plain twin, every single effect, then mixtures by forward selection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground, Part
from service.gap.fitting.predict import NOTHING_SEEN, NOTHING_TOLD, measured_signal, weight
from service.gap.fitting.stage import EXACT, PROBE
from service.gap.fitting.unknowns import slow_to_compute
from service.gap.measured.observation import GapError, Observation
from service.gap.weighing.significance import significance
from service.gap.weighing.verdict import UNEXPLAINED, UNEXPLAINED_BY_SEVERAL, Ranked, noise_levels, ranked
from service.gap.which.begun import LOOKED_FOR, beside, residuals, rough_beside, rough_stages
from service.gap.which.beyond import beyond_tolerance
from service.gap.which.curvature import SHOWN, curvatures
from service.gap.which.mixtures import exchanged, extended, leaves_something, with_one_more, worthy
from service.gap.which.plainer import plainer_law
from service.gap.which.refined import alike, best_of_each, contained, cost, refined, settled
from service.gap.which.uneven import uneven
from service.gap.which.woken import woken
from sim.effects import CATALOGUE

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

MOST = 3
"""Largest mixture within one part."""
HELD = 0.05
"""Share of a gap that an explanation of fewer sweeps may leave of more, to be the same valley for sure."""


@dataclass(frozen=True)
class Explained:
    """What the search found in one part."""

    ground: Ground
    order: tuple[Ranked, ...]
    """by falling evidence, the plain twin among them"""
    plain: tuple[Complex, ...]
    """weighted residuals of the plain twin, (P, H, n) per sweep"""
    left: tuple[Complex, ...]
    """the same of the best explanation"""
    elsewhere: tuple[Ranked, ...] = ()
    """by effects of another part, which would explain this one's gap about as well; log evidence on this one's scale"""

    @property
    def part(self) -> Part:
        """The part of the loop."""
        return self.ground.part

    @property
    def chosen(self) -> Candidate:
        """The explanation that other parts build on: the best one where it beats the plain twin, else that."""
        return self.order[0].candidate

    @property
    def null(self) -> Ranked:
        """The plain twin."""
        return next(r for r in self.order if not r.candidate.effects)

    @property
    def significance(self) -> float:
        """Of the gap that the plain twin leaves."""
        return gap_significance(self.plain, self.ground.observations)

    @property
    def relative_gap(self) -> float:
        """||measured - plain twin|| / ||measured|| of the part's output, fundamental, the largest of the sweeps."""
        shares = []
        for z, o in zip(self.plain, self.ground.observations, strict=True):
            w, f = weight(o, self.part.signal), o.fundamental
            size = float(np.linalg.norm(measured_signal(o, self.part.signal)[:, f]))
            shares.append(np.linalg.norm(z[:, f] / np.maximum(w[:, f], NOTHING_TOLD)) / max(size, NOTHING_SEEN))
        return float(max(shares))

    @property
    def remaining(self) -> float:
        """Significance of what the best explanation leaves."""
        return max(significance(z, o) for z, o in zip(self.left, self.ground.observations, strict=True))


def gap_significance(plain: Sequence[Complex], observations: Sequence[Observation]) -> float:
    """Significance of what the plain twin leaves at the excited frequency, over bands and channels."""
    return max(significance(z[:, [o.fundamental]], o, bound=np.inf) for z, o in zip(plain, observations, strict=True))


def plain_twin(
    fitter: Fitter, ground: Ground, before: Explained | None = None
) -> tuple[Candidate, tuple[Complex, ...]]:
    """The plain twin, the datasheet's values of the part refitted, and what it leaves, (P, H, n) per sweep.

    ``before`` is what was found on fewer sweeps.

    Raises
    ------
    GapError
        None can be fitted.
    """
    if before is None:
        task = Task(ground, (), ((),), ground.theta, (*rough_stages(ground), EXACT))
    else:
        task = Task(ground, (), ((),), before.null.candidate.fit.theta, (EXACT,))
    (null,) = fitter.each([task])
    if null is None:
        raise GapError(
            f"no twin can be fitted to the {ground.part.path}: with no values within four of their tolerances is the "
            "datasheet a rig that can be computed; check its values, those of the controller among them"
        )
    return null, residuals(ground, null)


def explain(
    fitter: Fitter,
    ground: Ground,
    plain_fit: tuple[Candidate, tuple[Complex, ...]] | None = None,
    most: int = MOST,
    before: Explained | None = None,
) -> Explained:
    """Fit the plain twin, every single effect of the part, and mixtures where one effect leaves too much.

    Parameters
    ----------
    plain_fit
        What `plain_twin` returned, where that was asked before.
    most
        Largest mixture to look at.
    before
        What was found on fewer sweeps: effects in proportion to the excitation go on from there, others also.
    """
    null, plain = plain_fit or plain_twin(fitter, ground)
    known = {} if before is None else {c.effects: c for c in (r.candidate for r in before.order)}
    # An effect draws the plain twin's values off, a large one as far as their tolerances let it: what is quickly
    # computed finds its own way from the datasheet's, and a resonance where hardly anything else is left.
    rough = rough_beside(null, ground)
    near = rough != rough_stages(ground)

    def theta(name: str) -> Real:
        return null.fit.theta if near and (slow_to_compute(name) or name in LOOKED_FOR) else ground.theta

    kept = [] if before is None else fitter.run(_gone_on_with(ground, before))
    probed = fitter.run(
        Task(ground, (name,), (known[name,].fit.values,), known[name,].fit.theta, (PROBE,))
        if (name,) in known and not CATALOGUE[name].nonlinear
        else beside(name, null, null, plain, ground, theta(name), rough)
        for name in ground.part.effects
        if name not in {c.effects[0] for c in kept if _holds(c, null)}
    )
    probed = _least_of_each([*probed, *kept])
    found = refined(fitter, ground, null, probed)
    if plainer := contained(fitter, ground, null, min(found, key=cost, default=null)):
        null, plain = plainer[0], residuals(ground, plainer[0])
        found = refined(fitter, ground, null, found)
    found = settled(fitter, ground, found)
    order, left = ranked(null, found), plain
    if _curved(ground, null, plain, order):
        most = 1
    if most > 1:
        found, order = _with_wider_laws(fitter, ground, null, found, order)
    fewer = next(r for r in order if r.candidate is null)
    for size in range(1, most + 1):
        left = residuals(ground, order[0].candidate)
        extension = None if size == most else extended(ground, order, fewer, size)
        if extension is None:
            break
        fewer = extension.base
        found = with_one_more(fitter, ground, order, extension, found)
        order = worthy(ranked(null, found))
    if len(order[0].candidate.effects) > 1:  # what else could stand for one of them, where nothing is left too
        found = best_of_each(null, [*found, *exchanged(fitter, ground, order[0].candidate, found)])
        order = worthy(ranked(null, found))
    if len(order[0].candidate.effects) > 1:
        _, order = _with_wider_laws(fitter, ground, null, found, order)
    order = beyond_tolerance(fitter, ground, order)
    # it leaves so little more that its evidence and shares stand
    order[0] = replace(order[0], candidate=plainer_law(fitter, ground, order[0].candidate))
    left = residuals(ground, order[0].candidate)
    return Explained(ground, tuple(order), plain, left)


def _gone_on_with(ground: Ground, before: Explained) -> Iterable[Task]:
    """Nonlinear effects that explained most of fewer sweeps, from where they did: their valleys are narrow.

    Where one does not hold, it is begun anew as well: a louder sweep may show that it was another valley.
    """
    null = before.null.candidate
    noise = sum(noise_levels(null, [r.candidate for r in before.order]))
    for c in (r.candidate for r in before.order):
        alone = len(c.effects) == 1 and CATALOGUE[c.effects[0]].nonlinear
        if alone and cost(c) - noise < 0.5 * (cost(null) - noise):
            yield Task(ground, c.effects, (c.fit.values,), c.fit.theta, (PROBE,))


def _holds(c: Candidate, null: Candidate) -> bool:
    """Whether an explanation leaves next to nothing of what the plain twin does."""
    return cost(c) - c.fit.n_residuals < HELD * (cost(null) - c.fit.n_residuals)


def _least_of_each(probed: Sequence[Candidate]) -> list[Candidate]:
    """Of fits of the same effects the one that leaves least."""
    least: dict[tuple[str, ...], Candidate] = {}
    for c in probed:
        if c.effects not in least or cost(c) < cost(least[c.effects]):
            least[c.effects] = c
    return list(least.values())


def _curved(ground: Ground, null: Candidate, plain: Sequence[Complex], order: Sequence[Ranked]) -> bool:
    """Whether a curved characteristic explains most of a part, more than any effect: mixtures would bend to it."""
    explained = max((c.explained for c in curvatures(ground, null, plain)), default=0.0)
    if explained < SHOWN:
        return False
    excess = cost(null) - sum(noise_levels(null, [r.candidate for r in order]))
    by_effects = cost(null) - min(cost(r.candidate) for r in order)
    return explained > max(by_effects, (1 - UNEXPLAINED) * excess)


def _with_wider_laws(
    fitter: Fitter, ground: Ground, null: Candidate, found: Sequence[Candidate], order: Sequence[Ranked]
) -> tuple[list[Candidate], list[Ranked]]:
    """What was found, and its order, with wider laws where the best leaves too much.

    Effects that differ from axis to axis, and those that have more of a law than most rigs need.
    """
    best = order[0].candidate
    asked = [best] if len(best.effects) > 1 else found
    asks = leaves_something(ground, order[0]) or leaves_much(null, order)
    # what looks like the best is held against it with all of its law: to be told apart takes both
    wider = [c for c in asked if asks or alike(c, best)]
    more = [*(uneven(fitter, ground, null, asked) if asks else ()), *woken(fitter, ground, wider)]
    if not more:
        return list(found), list(order)
    found = settled(fitter, ground, best_of_each(null, [*found, *more]))
    return found, worthy(ranked(null, found))


def leaves_much(null: Candidate, order: Sequence[Ranked]) -> bool:
    """Whether the best effects leave much of a gap, though overestimated noise hides it from every band."""
    best = order[0]
    left = cost(best.candidate) - sum(noise_levels(null, [r.candidate for r in order]))
    return bool(best.candidate.effects) and best.unexplained > UNEXPLAINED_BY_SEVERAL and left > SHOWN
