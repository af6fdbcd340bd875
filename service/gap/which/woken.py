"""Effects with more of their law than most rigs need, where the law that all have leaves much.

A disc that modes tilt, damping of one mode that turns with the shaft: such parameters lie where their law is the
plainest, at no price, until the best explanation leaves too much. Then fits begin where they do something.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import asleep
from service.gap.which.refined import alike, cost
from service.gap.which.uneven import hinted
from sim.effects import CATALOGUE


def woken(
    fitter: Fitter, ground: Ground, null: Candidate, best: Candidate, found: Sequence[Candidate]
) -> list[Candidate]:
    """Explanations of ``found`` with more of an effect's law, those that leave less; ``null`` is the plain twin.

    Those that explain something as they are, and what looks like the best.
    """
    asked = hinted(null, found)
    asked += [c for c in found if c not in asked and alike(c, best)]
    before = {c.effects: cost(c) for c in found}
    return [c for c in fitter.run(task for c in asked for task in _tasks(ground, c)) if cost(c) < before[c.effects]]


def awake(task: Task) -> Task | None:
    """The task with more of its last effect's law, from each of its starts; None where that has no more."""
    *_, name = task.effects
    wakes = _wakes(name, task.ground)
    starts = tuple((*others, {**own, **more}) for *others, own in task.starts for more in wakes)
    return replace(task, starts=starts) if wakes else None


def _tasks(ground: Ground, c: Candidate) -> Iterator[Task]:
    sleeping = asleep(c.effects, c.fit.values)
    for k, name in enumerate(c.effects):
        for more in _wakes(name, ground):
            if all((name, parameter) in sleeping for parameter in more):
                starts = (*c.fit.values[:k], {**c.fit.values[k], **more}, *c.fit.values[k + 1 :])
                yield Task(ground, c.effects, (starts,), c.fit.theta, (EXACT,))


def _wakes(name: str, ground: Ground) -> list[dict[str, float]]:
    """Values of an effect's dormant parameters from which fits begin that move them."""
    known = {p.name: p.wakes for p in CATALOGUE[name].of(ground.nuisance.rig).parameters if p.wakes}
    return [dict(zip(known, values, strict=True)) for values in product(*known.values())] if known else []
