"""Effects with the optional parameters of their law, which are fitted only where the basic law leaves too much.

A disc that modes tilt, damping of one mode that turns with the shaft: such a parameter is held at its null, and costs
no evidence, until the best explanation leaves too much. Then fits begin at values where it acts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

from service.gap.fitting.candidates import Candidate, Fitter, Task
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT
from service.gap.fitting.unknowns import asleep
from service.gap.which.refits import cost
from sim.effects import CATALOGUE

SHOWS = 0.2
"""Share of a typical strength from which such a fit begins, too: at none, no shape of an effect moves anything."""


def with_optional_parameters(fitter: Fitter, ground: Ground, found: Sequence[Candidate]) -> list[Candidate]:
    """Explanations of ``found`` with more of an effect's law, those that leave less.

    What the plain law explains is no hint: of a small disc that modes tilt far, the rigid body shows nothing.
    """
    before = {c.effects: cost(c) for c in found}
    return [c for c in fitter.run(task for c in found for task in _tasks(ground, c)) if cost(c) < before[c.effects]]


def with_all_parameters(task: Task) -> Task | None:
    """The task with more of its last effect's law, from each of its starts; None where that has no more."""
    *_, name = task.effects
    wakes = _wakes(name, task.ground)
    starts = tuple((*others, {**own, **more}) for *others, own in task.starts for more in wakes)
    return replace(task, starts=starts) if wakes else None


def _tasks(ground: Ground, c: Candidate) -> Iterator[Task]:
    """Fits that wake an effect: from the strength that its plain law has, and from one that shows."""
    sleeping = asleep(c.effects, c.fit.values)
    for k, name in enumerate(c.effects):
        parameters = CATALOGUE[name].of(ground.nuisance.rig).parameters
        shows = {p.name: p.null + SHOWS * (p.typical - p.null) for p in parameters if p.strength}
        for more in _wakes(name, ground):
            if all((name, parameter) in sleeping for parameter in more):
                own = c.fit.values[k]
                begun = ({**own, **more}, {**own, **shows, **more})
                starts = tuple((*c.fit.values[:k], one, *c.fit.values[k + 1 :]) for one in begun)
                yield Task(ground, c.effects, starts, c.fit.theta, (EXACT,))


def _wakes(name: str, ground: Ground) -> list[dict[str, float]]:
    """Values of an effect's dormant parameters from which fits begin that move them."""
    known = {p.name: p.wakes for p in CATALOGUE[name].of(ground.nuisance.rig).parameters if p.wakes}
    return [dict(zip(known, values, strict=True)) for values in product(*known.values())] if known else []
