"""The diagnosis: where the twin differs from the rig, which effect does it, how far the gap shrinks with it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace

from service.experiment.data import Experiment
from service.gap.compose import composed
from service.gap.dated import dated
from service.gap.diagnosis import Diagnosis, closures_of, listed
from service.gap.doubts.swings import swinging
from service.gap.fitting.candidates import Fitter
from service.gap.fitting.predict import at_speed_of
from service.gap.heard import once_a_turn, scatter_shrinkage, with_interference
from service.gap.hints import hints, one_point
from service.gap.interference import measured_by
from service.gap.judged import judged
from service.gap.loop import drawn_twins, loop_figures
from service.gap.next_experiment import Proposal
from service.gap.observed import Observed, observed
from service.gap.origin import origin
from service.gap.outdated import fewer, outdated
from service.gap.passes import PERCENT_FITTED, Found, found_in
from service.gap.proposal.case import Grounds
from service.gap.telling import ProgressCallback, Telling
from service.gap.weighing.shrinkage import relative_gap, relative_noise, shrinkage
from service.gap.where.discrepancy import discrepancy
from service.gap.where.where import locate
from service.gap.which.beyond import OFF_TOLERANCES
from service.gap.which.explained import Explained
from service.gap.which.rivals import left_together
from sim.datasheet import Datasheet
from sim.errors import AmbError


def diagnose(
    experiment: Experiment, datasheet: Datasheet, jobs: int = 1, progress: ProgressCallback | None = None
) -> Diagnosis:
    """Diagnose the gap between a rig's experiment and the twin of its datasheet.

    Parameters
    ----------
    jobs
        Processes that fit.
    progress
        Told the percent that are done, and what is done, after every fit.

    Raises
    ------
    GapError
        The data do not allow it: no excited sweep, too few points or blocks, axes that do not match.
    """
    data, telling = observed(experiment, datasheet), Telling(progress)
    with Fitter(jobs, telling.fitted) as fitter:
        found = found_in(data, fitter, telling)
        telling.judging(PERCENT_FITTED)
        told = _told(experiment.rig, datasheet, data, found, fitter)
        if datasheet.effects and told.verdict.kind != "no_gap" and told.verdict.settled:
            told = _of_a_twin(told, experiment, datasheet, fitter, telling)
    return replace(told, of=origin(experiment, datasheet))


def _of_a_twin(
    told: Diagnosis, experiment: Experiment, datasheet: Datasheet, fitter: Fitter, telling: Telling
) -> Diagnosis:
    """What was told, or that the twin is out of date: it is held against the twin without some of its effects."""
    without = {}
    for names, sheet in fewer(datasheet):
        telling.without(names, PERCENT_FITTED)
        fitter.lost.clear()  # of this twin alone
        with suppress(AmbError):  # without them it may be no rig that can be fitted
            data = observed(experiment, sheet)
            found = found_in(data, fitter, Telling(None))
            without[names] = _told(experiment.rig, sheet, data, found, fitter, propose=False)
    return outdated(told, without) or told


def _told(
    rig: str, datasheet: Datasheet, data: Observed, found: Found, fitter: Fitter, propose: bool = True
) -> Diagnosis:
    """What was found, judged and measured on data that no fit has seen; ``propose``: and what to measure next."""
    nu, o, unseen = data.nuisance, data.o, found.unseen
    notes = [*data.notes, *found.notes, *once_a_turn(data.sources), *not_weighed(fitter.lost, found.parts)]
    whole = dated(composed(nu, found.parts), nu.rig, data.duration_s)
    fitted = at_speed_of(whole.order[0].candidate.fit.rig, o)
    sources = [measured_by(s, data.main, fitted) if s.heard_hz else s for s in data.sources]
    null = whole.null.candidate
    swings = swinging([data.main, data.other], nu.rig)
    gap = relative_gap(null.fit.rig, o)
    verdict = judged(found.parts, o, unseen, gap, sources, found.fault, swings, data.lines_only, data.erratic)
    whole = with_interference(whole, verdict.effects, sources)
    chosen = next((r.candidate for r in whole.order if r.candidate.effects == verdict.effects), null)
    pair = left_together(whole.order, verdict) if propose else None
    proposal = Proposal(nu, pair, Grounds.of(data, datasheet), rig, fitter) if pair else None
    shrunk = {
        r.candidate.effects: shrinkage(null.fit.rig, r.candidate.fit.rig, unseen, found.name)
        for r in (*listed(whole.order, verdict.effects), whole.null)
    }
    closed = shrunk[chosen.effects if verdict.effects else ()]
    if sources and len(verdict.effects) == len(sources):
        closed = scatter_shrinkage(data.other, nu.rig, sources, found.name) or closed
        shrunk[verdict.effects] = closed
    where = locate(found.parts, data.unseen, verdict.effects, sources, verdict.unexplained, verdict.bent)
    if verdict.also_alike:
        told = ", ".join(name.replace("_", " ") for name in verdict.also_alike)
        notes.append(f"not told apart either: {told}")
    if verdict.effects:
        notes += hints(chosen, nu.rig, (o, unseen))
    elif not data.o.together:
        notes += one_point(found.parts, unseen, (data.main_name, found.name))
    if far := nu.far_off(chosen.fit.theta):
        drawn = " (what nothing explains may have drawn it there)" if verdict.kind == "none_of_these" else ""
        notes.append(f"the datasheet is off beyond its tolerances: {', '.join(far)}{drawn}")
    figures = loop_figures(
        null.fit.rig, chosen.fit.rig, o, {"before": drawn_twins(nu, null), "after": drawn_twins(nu, chosen)}
    )
    proposed = proposal.document() if proposal else None
    if pair and proposed is None:
        one, other_one = (" + ".join(c.effects).replace("_", " ") for c in pair)
        notes.append(f"no affordable experiment is likely to tell {one} from {other_one}")
    found_out = Diagnosis(
        rig,
        where,
        whole.order,
        verdict,
        closed,
        closures_of(whole.order, shrunk, verdict.effects),
        relative_gap(null.fit.rig, unseen),
        relative_noise(unseen, nu.rig.n_axes),
        {r.candidate.effects: relative_gap(r.candidate.fit.rig, unseen) for r in listed(whole.order, verdict.effects)},
        o,
        unseen,
        figures,
        proposed,
        tuple(notes),
        discrepancy(found.parts, where.blamed, data.unseen) if verdict.kind == "none_of_these" else None,
    )
    off = nu.far_off(null.fit.theta, OFF_TOLERANCES) if found_out.within_the_datasheet else []
    without = (
        [f"without an effect the datasheet would be off by more than a tolerance: {', '.join(off)}"] if off else []
    )
    return replace(found_out, notes=(*found_out.notes, *without))


def not_weighed(lost: Collection[tuple[str, ...]], parts: Sequence[Explained]) -> list[str]:
    """What is said of the single effects that were tried and of which no part has a fit."""
    weighed = {r.candidate.effects for e in parts for r in e.order}
    single = sorted(effects[0] for effects in lost if len(effects) == 1 and effects not in weighed)
    return [f"{name.replace('_', ' ')} was not weighed: no twin with it could be fitted" for name in single]
