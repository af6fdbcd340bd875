"""Every part of the loop explained: on the main sweep, then with half of the other where that does not hold there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.curved import curved
from service.gap.doubts.log import faint_log_fault, log_fault
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.inherited import inherited_from
from service.gap.fitting.part import Ground, Values, driven_by_current, parts
from service.gap.measured.observation import Observation
from service.gap.observed import Observed
from service.gap.telling import Telling
from service.gap.weighing.another_rig import hopeless
from service.gap.weighing.significance import OUTLIER, SIGNIFICANT, alone_hz, mean_power, significance
from service.gap.weighing.verdict import UNEXPLAINED, VISIBLE, rejected
from service.gap.which.begun import residuals
from service.gap.which.between import between
from service.gap.which.held_out import held_out, on_sweep
from service.gap.which.search import MOST, Explained, explain, plain_twin
from sim.effects import CATALOGUE

Real = NDArray[np.float64]

ONE_SWEEP, FITTED = 80.0, 97.0
"""Percent that are done when the main sweep is explained, and when every fit is done."""
UNDERSTOOD = 4.0
"""Significance of what is left of the amplifiers up to which the plant is held against u through them."""
NOISE_ALONE = 2.0
"""The same for the mean squared residual of a sweep: it counts single lines, of an amplifier at its limit, in full."""
BEYOND_CHANCE = 36.0
"""Chi-square that a prediction takes off data no fit has seen: without the effect, a predicted change of x standard
deviations takes off 2 n x - x^2 for noise of n along it, so that n has to be 6 or more, whatever x."""


@dataclass(frozen=True)
class Found:
    """The parts of the loop as they were explained, and what no fit has seen."""

    parts: tuple[Explained, ...]
    fault: str | None
    """what is wrong with the log"""
    unseen: Observation
    name: str
    """of what is unseen"""
    notes: tuple[str, ...] = ()


def found_in(data: Observed, fitter: Fitter, telling: Telling) -> Found:
    """The explanations of every part of the loop."""
    first = FITTED if data.lines_only else ONE_SWEEP
    found, fault = _explained(fitter, data, (data.o,), {}, telling, (0.0, first))
    if data.lines_only or fault:
        return Found(tuple(found), fault, data.unseen, data.name)
    undecided = [e for e in found if not _decided(e)]
    failing = {e.part.path: e for e in undecided if _fails_on(e, data.unseen)}
    alone = {e.part.path: hz for e in undecided if (hz := _fails_alone_hz(e, data.unseen))}
    if not failing and not alone:
        return Found(tuple(found), fault, data.unseen, data.name)
    halved = data.halves(next(iter(alone.values()), None))
    if halved is None:
        note = "the twin fits the main sweep but not the other, which has too few lines to fit half of it too"
        return Found(tuple(found), fault, data.unseen, data.name, (note,))
    seen, unseen, name = halved
    failing |= {e.part.path: e for e in undecided if e.part.path in alone}
    known = {e.part.path: e for e in found if e.part.path not in failing}
    found, fault = _explained(fitter, data, (data.o, seen), known, telling, (ONE_SWEEP, FITTED), failing)
    note = "the twin fits the main sweep but not the other: half of the other's lines were fitted too"
    return Found(tuple(found), fault, unseen, name, (note,))


def _explained(
    fitter: Fitter,
    data: Observed,
    observations: tuple[Observation, ...],
    known: Mapping[str, Explained],
    telling: Telling,
    percent: tuple[float, float],
    before: Mapping[str, Explained] | None = None,
) -> tuple[list[Explained], str | None]:
    """Every part of the loop explained, each on the ground of those before, and what is wrong with the log.

    ``known`` parts are not looked at again. Where interference is heard aloud, it and not the log is at fault. With a
    log at fault no mixtures are looked for: their effects would not be there. ``before`` is what fewer sweeps told of
    the others.
    """
    out: list[Explained] = []
    fault: str | None = None
    looked_at = parts(data.nuisance, observations)
    for part in looked_at:
        theta = out[-1].chosen.fit.theta if out else np.zeros(len(data.nuisance))
        named = tuple(found for e in out for found in _found(e.chosen))
        understood = all(_understood(e) for e in out if e.part.path == "amplifier")
        ground = Ground(data.nuisance, part, observations, theta, named)
        if part.path == "plant" and not understood:
            rig = ground.rig(theta)
            driven = tuple(driven_by_current(rig, o) for o in observations)
            ground = replace(ground, observations=driven, from_current=True)
        elif part.path == "plant" and out and out[-1].part.path == "amplifier":
            ground = _through(ground, out[-1], out[-1].chosen)
        if part.path not in known:
            telling.part(part, [p for p in looked_at if p.path not in known], *percent)
        result = known.get(part.path)
        if result is not None:
            result = _rebased(result, theta, named, data)
        else:
            sooner = (before or {}).get(part.path)
            plain = plain_twin(fitter, ground, sooner)
            if part.path == "plant" and not data.aloud:
                fault = log_fault(fitter, out, ground, plain, observations)
            result = explain(fitter, ground, plain, 1 if fault else MOST, sooner)
            if part.path == "plant" and not data.aloud and not fault:
                fault = faint_log_fault(fitter, out, result, result.chosen)
            if ground.inherited is not None and not fault:
                out[-1], result = _shared(fitter, out[-1], result)
        out.append(result)
    return out, fault


def _rebased(e: Explained, theta: Real, named: tuple[tuple[str, Values], ...], data: Observed) -> Explained:
    """A part that is not looked at again, where what was found in the other parts has changed.

    The amplifiers' effects are held as they are now: what was uncertain of them before says nothing of these.
    """
    ground = replace(e.ground, theta=theta, found=named, inherited=None)
    if ground.from_current:
        ground = replace(ground, observations=(driven_by_current(ground.rig(theta), data.o),))
    plain, left = (residuals(ground, c) for c in (e.null.candidate, e.order[0].candidate))
    return replace(e, ground=ground, plain=plain, left=left)


def _shared(fitter: Fitter, amplifiers: Explained, plant: Explained) -> tuple[Explained, Explained]:
    """Amplifiers and plant, an effect that either may have given to the one where it explains both better."""

    def through(candidate: Candidate) -> Ground:
        return _through(plant.ground, amplifiers, candidate)

    now, plant = between(fitter, amplifiers, plant, through)
    if now.chosen is not amplifiers.chosen:
        plant = explain(fitter, through(now.chosen))
    return now, plant


def _found(c: Candidate) -> tuple[tuple[str, Values], ...]:
    return tuple(zip(c.effects, c.fit.values, strict=True))


def _through(ground: Ground, amplifiers: Explained, candidate: Candidate) -> Ground:
    """The plant's ground behind an explanation of the amplifiers, with what is uncertain of it."""
    theirs = inherited_from(amplifiers.ground, candidate)
    uncertain = [name for name, _ in theirs.effects]
    fixed = tuple((name, values) for name, values in _found(candidate) if name not in uncertain)
    found = (*amplifiers.ground.found, *fixed)
    return replace(ground, theta=candidate.fit.theta, found=found, inherited=theirs)


def _understood(amplifiers: Explained) -> bool:
    """Whether the plant can be held against u through the amplifiers: what is left of them is noise, in every line."""
    groups = amplifiers.chosen.fit.groups[::2]
    return amplifiers.remaining < UNDERSTOOD and all(chi < NOISE_ALONE * count for chi, count in groups)


def _decided(e: Explained) -> bool:
    """Whether more data explain no more: the main sweep rejects what explains it best, or is of another rig."""
    return rejected(e.order[0], e.remaining) or hopeless(e.ground, (r.candidate.fit for r in e.order))


def _fails_on(e: Explained, unseen: Observation) -> bool:
    """Whether what explains the main sweep leaves a clear gap on the other one, or would be rejected by it.

    Or a curvature there, where nothing explains the main one: of a stop that few lines reach it may be all that shows.
    """
    o, z = on_sweep(e, e.chosen, unseen)
    clear = mean_power(z) > VISIBLE and significance(z, o) > SIGNIFICANT
    bent = not e.chosen.effects and curved(e, (o, z)) is not None
    return clear or bent or held_out(e, unseen).fails or told_by_the_other(e, unseen)


def told_by_the_other(e: Explained, unseen: Observation) -> bool:
    """Whether an effect that the main sweep hardly shows predicts the other one beyond what chance could.

    A force that grows with amplitude may be lost there in the mean of a band, and here in one effect's price.
    """
    best = e.chosen
    more = (
        r.candidate
        for r in e.order
        if set(r.candidate.effects) > set(best.effects)
        and any(CATALOGUE[name].nonlinear for name in set(r.candidate.effects) - set(best.effects))
    )
    left = _left(e, best, unseen)
    return any(left - _left(e, c, unseen) > BEYOND_CHANCE for c in more)


def _left(e: Explained, candidate: Candidate, unseen: Observation) -> float:
    """Chi-square that an explanation of the main sweep leaves of the other one; an outlier counts up to a bound."""
    _, z = on_sweep(e, candidate, unseen)
    return float(np.minimum(np.abs(z) ** 2, 2 * OUTLIER).sum())


def _fails_alone_hz(e: Explained, unseen: Observation) -> float | None:
    """The line of the other sweep that alone shows a gap that a limit may make, Hz; None where there is none.

    Nor where an effect explains as much of that line as its law in another program would.
    """
    o, z = on_sweep(e, e.chosen, unseen)
    hz = alone_hz(e.part, z, o)
    if hz is None or e.part.path == "amplifier" or not e.chosen.effects:
        return hz
    at = o.points_hz == hz
    _, plain = on_sweep(e, e.null.candidate, unseen)
    return hz if np.sum(np.abs(z[at]) ** 2) > UNEXPLAINED * np.sum(np.abs(plain[at]) ** 2) else None
