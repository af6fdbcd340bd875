"""Effects with the dormant parameters of their law, which are fitted only where the basic law leaves too much.

Examples are the slope of a disc that modes tilt, and internal damping that differs from mode to mode. Such a parameter
is held at its null, and costs no evidence, until the best explanation leaves too much. Then fits start at values where
it acts (`Parameter.wakes`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate, Fitter, Starts, Task
from service.gap.fitting.fit import Problem
from service.gap.fitting.part import Ground
from service.gap.fitting.stage import EXACT, PROBE
from service.gap.fitting.starts import added_filters
from service.gap.fitting.starts.resonances import unlike_planes
from service.gap.fitting.starts.splits import by_couplings, by_slopes
from service.gap.fitting.starts.stops import off_centre
from service.gap.fitting.starts.sweep_residuals import SweepResiduals
from service.gap.fitting.unknowns import TURNING, dormant_at_null
from service.gap.which.one_more_effect import rough_beside, rough_stages
from service.gap.which.refits import cost
from sim.effects import CATALOGUE
from sim.effects.magnetic_hysteresis import DENSITIES
from sim.errors import EffectError

Complex = NDArray[np.complex128]

SUPPORT, MODE, GYROSCOPIC = "support_resonance", "extra_flexible_mode", "gyroscopic_coupling"
CONTROLLER = "controller_mismatch"
STOP = "touchdown_contact"
HYSTERESIS = "magnetic_hysteresis"
EDDY, DISPLACEMENT_SHARE = "eddy_currents", "displacement_share"
DENSITY_AT_START = 0.1
"""Density of the plays of each band, over those of a Rayleigh loop, at which a fit of them starts."""
VISIBLE = 0.2
"""Share of the typical strength that is a start of such a fit, too: at zero strength no shape parameter has an
effect."""


def with_optional_parameters(fitter: Fitter, ground: Ground, found: Sequence[Candidate]) -> list[Candidate]:
    """Explanations of ``found`` with dormant parameters fitted, where the cost is lower.

    All are tried, whatever their basic law explains: a small disc that modes tilt far has no effect on a rigid rotor.
    """
    before = {c.effects: cost(c) for c in found}
    return [c for c in fitter.run(task for c in found for task in _tasks(ground, c)) if cost(c) < before[c.effects]]


def from_the_datasheet(ground: Ground, found: Sequence[Candidate]) -> Iterator[Task]:
    """Tasks to fit dormant parameters where nuisance values had made up for what the basic law lacks.

    Without logged currents, where those of amplifiers and magnets together make up for much. They are further off than
    their tolerances have them then, and the fits of `with_optional_parameters`, which begin with them, may not find
    back. Linear effects only: what the datasheet's values make of others takes too long.
    """
    for c in found if ground.part.from_control else ():
        if c.fit.penalty > len(c.fit.active) and not any(CATALOGUE[name].nonlinear for name in c.effects):
            for task in _tasks(ground, c):
                yield replace(task, theta=ground.theta, stages=(*rough_stages(ground), EXACT))


def softer_in_one_plane(
    ground: Ground, null: Candidate, plain: Sequence[Complex], found: Sequence[Candidate]
) -> Iterator[Task]:
    """Tasks to fit a support, or a mode, with the resonance that each plane shows; of those that ``found`` has alone.

    A resonance is narrow, so that no start with the same frequency in both planes leads there. ``plain`` are the
    residuals of the plain twin ``null``.
    """
    names = [name for name in (SUPPORT, MODE) if any(c.effects == (name,) for c in found)]
    if not names or ground.nuisance.rig.n_planes < 2:
        return
    unexplained = SweepResiduals(null.fit.rig, plain[0], ground.observations[0], ground)
    for name in names:
        effect = CATALOGUE[name].of(ground.nuisance.rig)
        typical = {p.name: p.wakes[0] if p.wakes else p.typical for p in effect.parameters}
        shares = [{"pedestals": share} for share in (0.0, 1.0)] if name == SUPPORT else [{}]
        starts = [({**typical, **own, **more},) for own in unlike_planes(effect, unexplained) for more in shares]
        if starts:
            rough = rough_beside(null, ground)
            theta = null.fit.theta if rough != rough_stages(ground) else ground.theta
            yield Task(ground, (name,), tuple(starts), theta, (*rough, EXACT))


def on_modes_that_split(ground: Ground, found: Sequence[Candidate]) -> Iterator[Task]:
    """Task to fit a gyroscopic moment by how far apart it splits the modes' peaks; none where none is in ``found``."""
    effect = CATALOGUE[GYROSCOPIC].of(ground.nuisance.rig)
    problem = Problem(ground, [effect])
    for c in found:
        if c.effects == (GYROSCOPIC,):
            (own,) = c.fit.values
            visible = {p.name: p.null + VISIBLE * (p.typical - p.null) for p in effect.parameters if p.strength}
            faint = any(abs(own[name]) < abs(value) for name, value in visible.items())
            starts = [by_slopes(problem, ground.theta, {**own, **at}) for at in ([{}, visible] if faint else [{}])]
            starts.append(by_couplings(problem, ground.theta, own))
            if split := tuple((start,) for start in starts if start):
                yield Task(ground, c.effects, split, ground.theta, (*rough_stages(ground), EXACT))


def on_stops_off_centre(
    ground: Ground, null: Candidate, plain: Sequence[Complex], found: Sequence[Candidate]
) -> Iterator[Task]:
    """Task to fit a stop whose axes and sides have clearances of their own, and rings; none where ``found`` has none.

    ``plain`` are the residuals of the plain twin ``null``.
    """
    basic = next((c for c in found if c.effects == (STOP,)), None)
    if basic is None:
        return
    effect = CATALOGUE[STOP].of(ground.nuisance.rig)
    furthest = max(range(len(plain)), key=lambda k: float(np.abs(ground.observations[k].Y).max()))
    unexplained = SweepResiduals(null.fit.rig, plain[furthest], ground.observations[furthest], ground)
    try:
        starts = off_centre(effect, basic.fit.values[0], unexplained)
    except EffectError:  # the fitted twin has another air gap than the datasheet, and cannot have such stops
        return
    if starts:
        held = frozenset({(STOP, "side")})  # which sides there are is told by where the middle is
        yield Task(ground, (STOP,), tuple((start,) for start in starts), null.fit.theta, (PROBE, EXACT), nulled=held)


def with_plays_of_uneven_density(ground: Ground, found: Sequence[Candidate]) -> Iterator[Task]:
    """Tasks to fit hysteresis of plays that are denser at some widths; none where ``found`` has none of one density.

    They start from the band that was found, and from plays of every width.
    """
    for c in found:
        if HYSTERESIS not in c.effects:
            continue
        k = c.effects.index(HYSTERESIS)
        if any(c.fit.values[k][name] for name in DENSITIES):
            continue  # fitted already
        denser = {**c.fit.values[k], **dict.fromkeys(DENSITIES, DENSITY_AT_START)}
        everywhere = {**denser, "narrowest_a": 0.0, "widest_inverse_per_a": 0.0}
        starts = tuple((*c.fit.values[:k], own, *c.fit.values[k + 1 :]) for own in (denser, everywhere))
        yield Task(ground, c.effects, starts, c.fit.theta, (EXACT,))


def with_an_added_filter(ground: Ground, null: Candidate, found: Sequence[Candidate]) -> Iterator[Task]:
    """Task to fit a controller with a filter that its datasheet has not; none where ``found`` has no such controller.

    ``null`` is the plain twin. The gain of the whole controller is held: the filter's gains make up for any other.
    """
    if not any(c.effects == (CONTROLLER,) for c in found):
        return
    effect = CATALOGUE[CONTROLLER].of(ground.nuisance.rig)
    own = {p.name: p.null for p in effect.parameters}
    own |= added_filters.start(effect, null.fit.rig, ground.observations[0])
    held = frozenset({(CONTROLLER, "gain_change")})
    yield Task(ground, (CONTROLLER,), ((own,),), null.fit.theta, (EXACT,), nulled=held)


def with_the_lag_of_the_displacement(ground: Ground, best: Candidate) -> Iterator[Task]:
    """Task to fit eddy currents with the share of their law that the displacement's flux has; none beside no such law.

    It is tried even where nothing is left: the law of the current alone then explains a whole force that lags by a time
    constant that is a fifth too long, with a corner that is not there.
    """
    if EDDY in best.effects and (EDDY, DISPLACEMENT_SHARE) in dormant_at_null(best.effects, best.fit.values):
        k = best.effects.index(EDDY)
        share = next(p for p in CATALOGUE[EDDY].parameters if p.name == DISPLACEMENT_SHARE).wakes[0]
        start = {**best.fit.values[k], DISPLACEMENT_SHARE: share}
        starts = ((*best.fit.values[:k], start, *best.fit.values[k + 1 :]),)
        yield Task(ground, best.effects, starts, best.fit.theta, (EXACT,))


def with_all_parameters(task: Task) -> Task | None:
    """The task with the dormant parameters of its last effect fitted, from each of its starts; None without any."""
    *_, name = task.effects
    dormant = _dormant_starts(name, task.ground)
    return replace(task, starts=partial(_woken, task, dormant)) if dormant else None


def _woken(task: Task, dormant: Sequence[Mapping[str, float]]) -> Starts:
    """Every start of a task, with each of the starts of its last effect's ``dormant`` parameters."""
    return tuple((*others, {**own, **more}) for *others, own in task.all_starts() for more in dormant)


def _tasks(ground: Ground, c: Candidate) -> Iterator[Task]:
    """Fits of one effect's dormant parameters: from the strength of its basic law, and from a visible one.

    Of an effect some of whose parameters are awake, the others wake beside them as these were fitted.
    """
    sleeping = dormant_at_null(c.effects, c.fit.values)
    for k, name in enumerate(c.effects):
        parameters = CATALOGUE[name].of(ground.nuisance.rig).parameters
        visible = {p.name: p.null + VISIBLE * (p.typical - p.null) for p in parameters if p.strength}
        woken = []
        for at in _dormant_starts(name, ground):
            more = {parameter: value for parameter, value in at.items() if (name, parameter) in sleeping}
            if not more or more in woken:
                continue
            woken.append(more)
            own = c.fit.values[k]
            own_starts = [{**own, **more}, *([{**own, **visible, **more}] if len(more) == len(at) else [])]
            starts = tuple((*c.fit.values[:k], start, *c.fit.values[k + 1 :]) for start in own_starts)
            yield Task(ground, c.effects, starts, c.fit.theta, (EXACT,))


def _dormant_starts(name: str, ground: Ground) -> list[dict[str, float]]:
    """Starts of an effect's dormant parameters, at which they act."""
    at_rest = not any(o.speed_rad_s for o in ground.observations)
    asleep = {parameter for effect, parameter in TURNING if effect == name and at_rest}
    parameters = CATALOGUE[name].of(ground.nuisance.rig).parameters
    known = {p.name: p.wakes for p in parameters if p.wakes and p.name not in asleep}
    return [dict(zip(known, values, strict=True)) for values in product(*known.values())] if known else []
