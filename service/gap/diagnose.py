"""The diagnosis: where the twin differs from the rig, which effect explains it, how far the gap closes with it."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from service.experiment.data import Experiment
from service.gap.compose import Composition, composed
from service.gap.diagnosis import Diagnosis, closures_of, listed
from service.gap.doubts.modulated_stiffness import modulated_stiffness
from service.gap.drift_rate import with_drift_rate
from service.gap.explain_parts import PERCENT_FITTED, Found, explain_parts
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.predict import at_speed_of
from service.gap.hints import hints, moved_modes_shown, one_point, unseen_modes, unsettled_lines
from service.gap.interference import Interference, at_speed, measured_by
from service.gap.loop import loop_of
from service.gap.lost_loop import LIMIT, LostLoop, with_limit
from service.gap.observed import Observed, observed
from service.gap.origin import origin
from service.gap.outdated import judged_without, twins_without_effects, what_is_left
from service.gap.overall_verdict import overall_verdict
from service.gap.progress import Progress, ProgressCallback
from service.gap.weighing.shrinkage import Shrinkage, Unseen, relative_gap, relative_noise, shrinkage
from service.gap.weighing.verdict import LEAVES, MIXTURE_SHARE, Verdict
from service.gap.where.discrepancy import discrepancy
from service.gap.where.where import locate
from service.gap.which.beyond_tolerance import OFF_TOLERANCES
from service.gap.which.explained import Explained
from service.gap.which.rivals import in_question, pair_to_separate
from service.gap.with_interference import runout_notes, scatter_shrinkage, with_interference
from sim.datasheet import Datasheet
from sim.errors import AmbError
from sim.wording import in_words

if TYPE_CHECKING:
    from service.gap.next_experiment import Proposal

FARTHEST = 5
"""Values of a datasheet that are named as off where something else may have drawn them all there."""


def diagnose(
    experiment: Experiment, datasheet: Datasheet, jobs: int = 1, progress: ProgressCallback | None = None
) -> Diagnosis:
    """Diagnose the gap between a rig's experiment and the twin of its datasheet.

    Parameters
    ----------
    jobs
        Number of processes for the fits.
    progress
        Called after every fit with the percent done and a sentence.

    Raises
    ------
    GapError
        The data do not allow it: no excited sweep, too few points or blocks, axes that do not match.
    """
    data, done = observed(experiment, datasheet), Progress(progress)
    with Fitter(jobs, done.fitted) as fitter:
        found = explain_parts(data, fitter, done)
        done.judging(PERCENT_FITTED)
        diagnosis = _diagnosis(experiment.rig, datasheet, data, found, fitter)
        if datasheet.effects and diagnosis.verdict.kind != "no_gap" and diagnosis.verdict.settled:
            without = _without_effects_of_twin(experiment, datasheet, fitter, done)
            if judged := judged_without(diagnosis, without):
                seemed = diagnosis.verdict.effects
                diagnosis = _diagnosis(experiment.rig, datasheet, data, found, fitter, propose=False, given=judged[0])
                diagnosis = _of_own_effects(diagnosis, judged[1], seemed)
    return replace(diagnosis, of=origin(experiment, datasheet))


def _of_own_effects(d: Diagnosis, other: Diagnosis, seemed: tuple[str, ...]) -> Diagnosis:
    """A diagnosis whose verdict is on the twin's own effects, from ``other``, that of the twin without them.

    ``seemed`` are the effects that the twin's gap would be named for.
    """
    if d.verdict.outdated:
        closed = shrinkage(d.null.fit.rig, other.chosen.fit.rig, d.held_out, d.shrinkage.held_out)
        return replace(d, shrinkage=closed, notes=other.notes)
    return replace(d, notes=(*d.notes, what_is_left(seemed))) if d.verdict.kind == "no_gap" else d


def _without_effects_of_twin(
    experiment: Experiment, datasheet: Datasheet, fitter: Fitter, progress: Progress
) -> dict[tuple[str, ...], Diagnosis]:
    """Diagnoses of the twin without some of its effects, by the effects left out."""
    without = {}
    for names, sheet in twins_without_effects(datasheet):
        progress.without(names, PERCENT_FITTED)
        fitter.lost.clear()  # what is lost is reported of one twin only
        with suppress(AmbError):  # without them it may be a rig that cannot be fitted
            data = observed(experiment, sheet)
            found = explain_parts(data, fitter, Progress(None))
            without[names] = _diagnosis(experiment.rig, sheet, data, found, fitter, propose=False)
    return without


def _diagnosis(
    rig: str,
    datasheet: Datasheet,
    data: Observed,
    found: Found,
    fitter: Fitter,
    propose: bool = True,
    given: Verdict | None = None,
) -> Diagnosis:
    """The diagnosis from the parts' explanations: verdict, closure on unseen data, and a proposal if asked for.

    The verdict follows from the parts, unless it is ``given``: then doubts of the whole, as of a log, still apply.
    """
    nu, o, unseen = data.nuisance, data.o, found.unseen
    whole = with_drift_rate(composed(nu, found.parts), nu.rig, data.duration_s)
    null = whole.null.candidate
    sources = _measured_sources(data, whole)
    likely = whole.order[0].candidate  # which the verdict will most often name: its loop is computed meanwhile
    loop = fitter.beside(partial(loop_of, nu, null, likely, o))
    lost = None if data.erratic is None else LostLoop.of(data.erratic, null.fit.rig)
    verdict = overall_verdict(
        found.parts,
        o,
        unseen,
        relative_gap(null.fit.rig, o),
        sources,
        found.fault,
        modulated_stiffness([data.main, data.other], nu.rig, [name for name, _ in datasheet.effects]),
        data.lines_only,
        lost,
        None if data.tone is None else data.tone.in_words(nu.rig.axes),
        given,
    )
    if lost is not None and LIMIT in verdict.effects and not _fitted(found, LIMIT):
        whole = with_limit(whole, nu, lost)
    whole = with_interference(whole, verdict.effects, sources)
    chosen = next((r.candidate for r in whole.order if r.candidate.effects == verdict.effects), null)
    if chosen is not likely:
        loop = fitter.beside(partial(loop_of, nu, null, chosen, o))
    pair = pair_to_separate(whole.order, verdict) if propose else None
    others = in_question(whole.order, verdict) if pair else []
    proposal = _proposal(pair, others, data, datasheet, rig, fitter) if pair else None
    shrunk = _shrinkages(whole, data, found, verdict, sources)
    where = locate(found.parts, data.unseen, verdict.effects, sources, verdict.unexplained, verdict.nonlinear)
    diagnosis = Diagnosis(
        rig=rig,
        where=where,
        order=whole.order,
        verdict=verdict,
        shrinkage=shrunk[chosen.effects if verdict.effects else ()],
        closures=closures_of(whole.order, shrunk, verdict.effects),
        gap_before=relative_gap(null.fit.rig, unseen),
        noise_floor=relative_noise(unseen, nu.rig.n_axes),
        gaps_after={
            r.candidate.effects: relative_gap(r.candidate.fit.rig, unseen) for r in listed(whole.order, verdict.effects)
        },
        observation=o,
        held_out=unseen,
        loop=loop(),
        next_experiment=proposal.document() if proposal else None,
        discrepancy=discrepancy(found.parts, where.blamed, data.unseen) if verdict.kind == "none_of_these" else None,
        datasheet_off=() if leaves_some(verdict, found.parts) else tuple(nu.clearly_off(chosen.fit.theta)),
        beyond_tolerance=tuple(nu.far_off(chosen.fit.theta)),
    )
    notes = (*data.notes, *found.notes, *runout_notes(data.sources), *not_weighed(fitter.lost, found.parts))
    return replace(diagnosis, notes=(*notes, *_notes(diagnosis, data, found), *_undecided(diagnosis, pair)))


def _proposal(
    pair: tuple[Candidate, Candidate],
    others: Sequence[Candidate],
    data: Observed,
    datasheet: Datasheet,
    rig: str,
    fitter: Fitter,
) -> Proposal:
    """The search for the experiment that separates two explanations, safe with the others in question, begun."""
    # with the campaign that it rehearses: takes a while to load, and only what is left together needs it
    from service.gap.next_experiment import Proposal
    from service.gap.proposal.case import Grounds

    return Proposal(data.nuisance, pair, Grounds.of(data, datasheet), rig, fitter, others)


def _fitted(found: Found, effect: str) -> bool:
    """Whether an effect is in the fitted explanation of a part."""
    return any(effect in e.chosen.effects for e in found.parts)


def _measured_sources(data: Observed, whole: Composition) -> list[Interference]:
    """Interference with the amplitudes that follow from the best twin's loop."""
    best, measured = whole.order[0].candidate.fit.rig, []
    for source in data.sources:
        # runout of a rotor that stood still in the main sweep is heard in the other
        sweep, o = (data.main, data.o) if at_speed([source], data.main.speed_rad_s) else (data.other, data.unseen)
        measured.append(measured_by(source, sweep, at_speed_of(best, o)) if source.heard_hz else source)
    return measured


def _shrinkages(
    whole: Composition, data: Observed, found: Found, verdict: Verdict, sources: Sequence[Interference]
) -> dict[tuple[str, ...], Shrinkage]:
    """Closure on unseen data of each explanation that the report lists, and of the plain twin."""
    sweep = Unseen(whole.null.candidate.fit.rig, found.unseen, found.name)
    shrunk = {
        r.candidate.effects: sweep.shrinkage(r.candidate.fit.rig)
        for r in (*listed(whole.order, verdict.effects), whole.null)
    }
    if sources and len(verdict.effects) == len(sources):
        of_scatter = scatter_shrinkage(data.other, data.nuisance.rig, sources, found.name)
        shrunk[verdict.effects] = of_scatter or shrunk[verdict.effects]
    return shrunk


def _notes(d: Diagnosis, data: Observed, found: Found) -> Iterator[str]:
    """Notes beside the verdict."""
    nu, verdict = data.nuisance, d.verdict
    if verdict.also_alike:
        yield f"not told apart either: {', '.join(map(in_words, verdict.also_alike))}"
    yield from verdict.beside
    if data.tone is not None and verdict.effects:
        yield data.tone.in_words(nu.rig.axes)
    if verdict.kind == "none_of_these":
        yield from unsettled_lines(found.parts)
        yield from moved_modes_shown(found.parts) if not verdict.misstated else ()
    else:
        yield from hints(d.chosen, nu.rig, (d.observation, d.held_out), data.polar_inertia_kgm2)
    if verdict.kind == "no_gap":
        yield from unseen_modes(nu.rig, (d.observation, d.held_out))
    if not data.o.together:
        yield from one_point(found.parts, d.held_out, (data.main_name, found.name))
    if d.beyond_tolerance and not verdict.misstated:  # the wrong value has drawn the others off
        values = values_off(d.beyond_tolerance, leaves_some(verdict, found.parts))
        yield f"the datasheet is off beyond its tolerances: {values}"
    if d.within_the_datasheet and (off := nu.far_off(d.null.fit.theta, OFF_TOLERANCES)):
        yield f"without an effect the datasheet would be off by more than a tolerance: {', '.join(off)}"


def leaves_some(verdict: Verdict, parts: Sequence[Explained]) -> bool:
    """Whether something is left that is not explained, and may have drawn the datasheet's values from where they are.

    Where nothing explains the gap, or an effect explains it by another law than the rig's.
    """
    left = (e for e in parts if e.chosen.effects and e.order[0].unexplained > MIXTURE_SHARE)
    return verdict.kind == "none_of_these" or any(e.remaining > LEAVES for e in left)


def values_off(far: Sequence[str], unexplained: bool) -> str:
    """Which values are off, the farthest first; a few of them where what is ``unexplained`` may have drawn them there.

    >>> values_off(["mass -2 %"], unexplained=True)
    'mass -2 % (what nothing explains may have drawn it there)'
    """
    if not unexplained:
        return ", ".join(far)
    more = f" and {len(far) - FARTHEST} more" if len(far) > FARTHEST else ""
    drawn = "them" if len(far) > 1 else "it"
    return f"{', '.join(far[:FARTHEST])}{more} (what nothing explains may have drawn {drawn} there)"


def _undecided(d: Diagnosis, pair: tuple[Candidate, Candidate] | None) -> Iterator[str]:
    """A note where no experiment is proposed to separate two explanations."""
    if pair and d.next_experiment is None:
        one, other = (in_words("+".join(c.effects)) for c in pair)
        yield f"no affordable experiment is likely to tell {one} from {other}"


def not_weighed(lost: Collection[tuple[str, ...]], parts: Sequence[Explained]) -> list[str]:
    """Notes on the single effects that could not be fitted."""
    weighed = {r.candidate.effects for e in parts for r in e.order}
    single = sorted(effects[0] for effects in lost if len(effects) == 1 and effects not in weighed)
    return [f"{in_words(name)} was not weighed: no twin with it could be fitted" for name in single]
