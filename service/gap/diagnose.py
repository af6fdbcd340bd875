"""The diagnosis: where the twin differs from the rig, which effect does it, how far the gap shrinks with it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

from service.experiment.data import Experiment
from service.gap.candidates import Candidate, Fitter
from service.gap.compose import composed, dated, with_interference
from service.gap.discrepancy import discrepancy
from service.gap.document import gap_document, listed
from service.gap.interference import measured_by, scatter_shrinkage
from service.gap.judged import judged
from service.gap.loop import drawn_twins, loop_figures
from service.gap.next_experiment import next_experiment
from service.gap.observation import Observation
from service.gap.observed import observed
from service.gap.passes import FITTED, found_in
from service.gap.predict import at_speed_of
from service.gap.rivals import left_together
from service.gap.search import Explained
from service.gap.shrinkage import Shrinkage, relative_gap, relative_noise, shrinkage
from service.gap.telling import ProgressCallback, Telling
from service.gap.verdict import Ranked, Verdict
from service.gap.where import Where, locate
from sim.datasheet import Datasheet


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a diagnosis found; `service.gap.document` turns it into gap.json."""

    rig: str
    where: Where
    order: tuple[Ranked, ...]
    verdict: Verdict
    shrinkage: Shrinkage
    closures: dict[tuple[str, ...], float | None]
    gap_before: float
    noise_floor: float
    gaps_after: dict[tuple[str, ...], float]
    observation: Observation
    held_out: Observation
    loop: dict[str, Any] = field(default_factory=dict)
    """sensitivity peaks per axis: predicted before and after, measured; largest nu-gap before and after"""
    next_experiment: dict[str, Any] | None = None
    notes: tuple[str, ...] = field(default=())
    discrepancy: dict[str, Any] | None = None
    """where nothing explains the gap, its shape over frequency, amplitude and channel"""

    def to_dict(self) -> dict[str, Any]:
        """The document gap.json."""
        return gap_document(self)

    @property
    def null(self) -> Candidate:
        """The plain twin, its datasheet's values refitted."""
        return next(r.candidate for r in self.order if not r.candidate.effects)

    @property
    def chosen(self) -> Candidate:
        """The explanation that the verdict names, else the best one."""
        return next((r.candidate for r in self.order if r.candidate.effects == self.verdict.effects), self.null)


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
    telling.judging(FITTED)
    nu, o, unseen = data.nuisance, data.o, found.unseen
    notes = [*data.notes, *found.notes, *not_weighed(fitter.lost, found.parts)]
    whole = dated(composed(nu, found.parts), nu.rig, data.duration_s)
    fitted = at_speed_of(whole.order[0].candidate.fit.rig, o)
    sources = [measured_by(s, data.main, fitted) if s.heard_hz else s for s in data.sources]
    whole = with_interference(whole, sources)
    null = whole.null.candidate
    verdict = judged(found.parts, o, unseen, relative_gap(null.fit.rig, o), sources, found.fault, data.lines_only)
    chosen = next((r.candidate for r in whole.order if r.candidate.effects == verdict.effects), null)
    shrunk = {
        r.candidate.effects: shrinkage(null.fit.rig, r.candidate.fit.rig, unseen, found.name)
        for r in (*listed(whole.order, verdict.effects), whole.null)
    }
    closed = shrunk[chosen.effects if verdict.effects else ()]
    if sources and len(verdict.effects) == len(sources):
        closed = scatter_shrinkage(data.other, nu.rig, sources, found.name) or closed
        shrunk[verdict.effects] = closed
    where = locate(found.parts, data.unseen, verdict.effects, sources, verdict.unexplained, verdict.bent)
    pair = left_together(whole.order, verdict)
    proposal = next_experiment(nu, pair, o, experiment.rig)
    if verdict.kind != "none_of_these" and (far := nu.far_off(chosen.fit.theta)):
        notes.append(f"the datasheet is off beyond its tolerances: {', '.join(far)}")
    if pair and proposal is None:
        one, other_one = (" + ".join(c.effects).replace("_", " ") for c in pair)
        notes.append(f"no affordable experiment is likely to tell {one} from {other_one}")
    return Diagnosis(
        experiment.rig,
        where,
        whole.order,
        verdict,
        closed,
        {effects: of.closure for effects, of in shrunk.items()},
        relative_gap(null.fit.rig, unseen),
        relative_noise(unseen, nu.rig.n_axes),
        {r.candidate.effects: relative_gap(r.candidate.fit.rig, unseen) for r in listed(whole.order, verdict.effects)},
        o,
        unseen,
        loop_figures(
            null.fit.rig, chosen.fit.rig, o, {"before": drawn_twins(nu, null), "after": drawn_twins(nu, chosen)}
        ),
        proposal,
        tuple(notes),
        discrepancy(found.parts, where.blamed, data.unseen) if verdict.kind == "none_of_these" else None,
    )


def not_weighed(lost: Collection[tuple[str, ...]], parts: Sequence[Explained]) -> list[str]:
    """What is said of the single effects that were tried and of which no part has a fit."""
    weighed = {r.candidate.effects for e in parts for r in e.order}
    single = sorted(effects[0] for effects in lost if len(effects) == 1 and effects not in weighed)
    return [f"{name.replace('_', ' ')} was not weighed: no twin with it could be fitted" for name in single]
