"""The diagnosis: where the twin differs from the rig, which effect does it, how far the gap shrinks with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from service.experiment.data import Experiment
from service.gap.candidates import Candidate, Fitter
from service.gap.compose import (
    chosen_in,
    composed,
    dated,
    on_sweep,
    with_interference,
)
from service.gap.conditions import same_condition
from service.gap.discrepancy import discrepancy
from service.gap.document import gap_document, listed
from service.gap.interference import hums_hz, interference, measured_by, scatter_shrinkage
from service.gap.judged import judged
from service.gap.log import log_fault
from service.gap.loop import drawn_twins, loop_figures
from service.gap.modes import with_identified_modes
from service.gap.next_experiment import next_experiment
from service.gap.nuisance import Nuisance, nuisance
from service.gap.observation import GapError, Observation, observe
from service.gap.part import Ground, Values, driven_by_current, parts
from service.gap.predict import at_speed_of
from service.gap.rivals import left_together
from service.gap.search import MOST, Explained, explain, plain_twin
from service.gap.settling import DRIFTS
from service.gap.shrinkage import Shrinkage, relative_gap, relative_noise, shrinkage
from service.gap.significance import SIGNIFICANT, shows_alone_hz, significance
from service.gap.sweeps import halves, notes_on, span_s, sweeps_for
from service.gap.telling import ProgressCallback, Telling
from service.gap.thin import thinned
from service.gap.verdict import VISIBLE, Ranked, Verdict
from service.gap.where import Where, locate
from sim.datasheet import Datasheet

ONE_SWEEP, FITTED = 80.0, 97.0
"""Percent that are done when the main sweep is explained, and when every fit is done."""
UNDERSTOOD = 4.0
"""Significance of what is left of the amplifiers up to which the plant is held against u through them."""
NOISE_ALONE = 2.0
"""The same for the mean squared residual of a sweep: it counts single lines, of an amplifier at its limit, in full."""


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a diagnosis found; `service.gap.report` turns it into gap.json."""

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
    if experiment.axes != datasheet.axes:
        raise GapError(f"the experiment has axes {list(experiment.axes)}, the datasheet {list(datasheet.axes)}")
    main, other, name = sweeps_for(experiment)
    notes = notes_on(main, other, datasheet)
    if not datasheet.modes:
        datasheet, note = with_identified_modes(experiment, datasheet)
        notes.append(note)
    nu = nuisance(datasheet)
    lines_only = other is None
    if other is None:
        line = np.unique(main.frequency_hz, return_inverse=True)[1]
        main, other = main.select(line % 2 == 0), main.select(line % 2 == 1)
    sources = interference(main, nu.rig)
    hums = hums_hz(sources)
    span = span_s(main, other)
    o = observe(thinned(main), nu.rig, (0.0, 0.8), hums, span)
    unseen = whole_other = observe(thinned(other), nu.rig, (0.8, 1.0), hums, span)
    if o.unsettled > DRIFTS:
        notes.append(f"{100 * o.unsettled:.0f} % of the points had not settled: they drift from block to block")
    if not lines_only and (same := same_condition(o, unseen)):
        notes.append(same)
    telling = Telling(progress)
    with Fitter(jobs, telling.fitted) as fitter:
        aloud = not all(s.heard_hz for s in sources)
        found, fault = _explained(fitter, nu, (o,), {}, aloud, telling, (0.0, FITTED if lines_only else ONE_SWEEP))
        failing = {} if lines_only or fault else {e.part.path: e for e in found if _fails_on(e, unseen)}
        alone = {} if lines_only or fault else {e.part.path: hz for e in found if (hz := _fails_alone_hz(e, unseen))}
        if failing or alone:
            seen, unseen, name = halves(other, nu, name, hums, span, next(iter(alone.values()), None))
            failing |= {e.part.path: e for e in found if e.part.path in alone}
            known = {e.part.path: e for e in found if e.part.path not in failing}
            found, fault = _explained(fitter, nu, (o, seen), known, aloud, telling, (ONE_SWEEP, FITTED), failing)
            notes.append("the twin fits the main sweep but not the other: half of the other's lines were fitted too")
    telling.judging(FITTED)
    whole = dated(composed(nu, found), nu.rig, None if span is None else span[1] - span[0])
    fitted = at_speed_of(whole.order[0].candidate.fit.rig, o)
    sources = [measured_by(s, main, fitted) if s.heard_hz else s for s in sources]
    whole = with_interference(whole, sources)
    null = whole.null.candidate
    verdict = judged(found, o, unseen, relative_gap(null.fit.rig, o), sources, fault)
    closures, gaps = {}, {}
    before = shrinkage(null.fit.rig, null.fit.rig, unseen, name)
    for r in listed(whole.order, verdict.effects):
        after = shrinkage(null.fit.rig, r.candidate.fit.rig, unseen, name)
        closures[r.candidate.effects] = after.closure
        gaps[r.candidate.effects] = relative_gap(r.candidate.fit.rig, unseen)
    chosen = next((r.candidate for r in whole.order if r.candidate.effects == verdict.effects), null)
    shrunk = shrinkage(null.fit.rig, chosen.fit.rig, unseen, name) if verdict.effects else before
    if sources and len(verdict.effects) == len(sources):
        shrunk = scatter_shrinkage(other, nu.rig, sources, name) or shrunk
        closures[verdict.effects] = shrunk.closure
    where = locate(found, whole_other, verdict.effects, sources)
    pair = left_together(whole.order, verdict)
    proposal = next_experiment(nu, pair, o, experiment.rig)
    if pair and proposal is None:
        one, other_one = (" + ".join(c.effects).replace("_", " ") for c in pair)
        notes.append(f"no affordable experiment is likely to tell {one} from {other_one}")
    return Diagnosis(
        experiment.rig,
        where,
        whole.order,
        verdict,
        shrunk,
        closures,
        relative_gap(null.fit.rig, unseen),
        relative_noise(unseen, nu.rig.n_axes),
        gaps,
        o,
        unseen,
        loop_figures(
            null.fit.rig, chosen.fit.rig, o, {"before": drawn_twins(nu, null), "after": drawn_twins(nu, chosen)}
        ),
        proposal,
        tuple(notes),
        discrepancy(found, where.blamed, whole_other) if verdict.kind == "none_of_these" else None,
    )


def _explained(
    fitter: Fitter,
    nu: Nuisance,
    observations: tuple[Observation, ...],
    known: dict[str, Explained],
    aloud: bool,
    telling: Telling,
    percent: tuple[float, float],
    before: Mapping[str, Explained] | None = None,
) -> tuple[list[Explained], str | None]:
    """Every part of the loop explained, each on the ground of those before, and what is wrong with the log.

    ``known`` parts are not looked at again. Where interference is ``aloud``, it and not the log is at fault. With a
    log at fault no mixtures are looked for: their effects would not be there. ``before`` is what fewer sweeps told of
    the others.
    """
    out: list[Explained] = []
    fault: str | None = None
    theta = np.zeros(len(nu))
    named: list[tuple[str, Values]] = []
    looked_at = parts(nu, observations)
    for part in looked_at:
        understood = all(_understood(e) for e in out if e.part.path == "amplifier")
        ground = Ground(nu, part, observations, theta, tuple(named))
        if part.path == "plant" and not understood:
            rig = ground.rig(theta)
            driven = tuple(driven_by_current(rig, o) for o in observations)
            ground = replace(ground, observations=driven, from_current=True)
        if part.path not in known:
            telling.part(part, [p for p in looked_at if p.path not in known], *percent)
        result = known.get(part.path)
        if result is not None:  # what was found in the other parts has changed
            result = replace(result, ground=replace(result.ground, theta=theta, found=tuple(named)))
        else:
            sooner = (before or {}).get(part.path)
            plain = plain_twin(fitter, ground, sooner)
            if part.path == "plant" and not aloud:
                fault = log_fault(fitter, out, ground, plain)
            result = explain(fitter, ground, plain, 1 if fault else MOST, sooner)
        out.append(result)
        chosen = chosen_in(result)
        theta = chosen.fit.theta
        named += zip(chosen.effects, chosen.fit.values, strict=True)
    return out, fault


def _understood(amplifiers: Explained) -> bool:
    """Whether the plant can be held against u through the amplifiers: what is left of them is noise, in every line."""
    groups = chosen_in(amplifiers).fit.groups[::2]
    return amplifiers.remaining < UNDERSTOOD and all(chi < NOISE_ALONE * count for chi, count in groups)


def _fails_on(e: Explained, unseen: Observation) -> bool:
    """Whether what explains the main sweep leaves a clear gap on the other one."""
    o, z = on_sweep(e, chosen_in(e), unseen)
    return float(np.mean(np.abs(z) ** 2) / 2) > VISIBLE and significance(z, o) > SIGNIFICANT


def _fails_alone_hz(e: Explained, unseen: Observation) -> float | None:
    """The line of the other sweep that alone shows a gap in the amplifiers, Hz; other parts have peaks that look so."""
    if e.part.path != "amplifier":
        return None
    o, z = on_sweep(e, chosen_in(e), unseen)
    return shows_alone_hz(z, o)
