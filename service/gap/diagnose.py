"""The diagnosis: where the twin differs from the rig, which effect does it, how far the gap shrinks with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from service.experiment.data import Experiment, Sweep
from service.gap.candidates import Candidate, Fitter, Task, possible, starts
from service.gap.document import gap_document
from service.gap.fit import COARSE, EXACT, MIDDLE, PROBE
from service.gap.loop import loop_figures
from service.gap.next_experiment import next_experiment
from service.gap.nuisance import Nuisance, nuisance
from service.gap.observation import GapError, Observation, observe
from service.gap.predict import residual
from service.gap.shrinkage import Shrinkage, per_point, relative_gap, relative_noise, shrinkage
from service.gap.thin import thinned
from service.gap.verdict import MIXED, VISIBLE, Ranked, Verdict, decide, ranked
from service.gap.where import SIGNIFICANT, Where, locate, significance
from sim.datasheet import Datasheet
from sim.effects import CATALOGUE

PAIRED = 5
"""Best single effects that are also tried in pairs."""
REFINED = 6
"""Best candidates of a round that are fitted to the end; the others stay where a few steps brought them."""
PROBING = (COARSE, MIDDLE, PROBE)


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a diagnosis found; `service.gap.report` turns it into gap.json."""

    rig: str
    where: Where
    order: tuple[Ranked, ...]
    verdict: Verdict
    shrinkage: Shrinkage
    closures: dict[tuple[str, ...], float]
    gap_before: float
    noise_floor: float
    gaps_after: dict[tuple[str, ...], float]
    observation: Observation
    held_out: Observation
    loop: dict[str, Any] = field(default_factory=dict)
    """sensitivity peaks per axis: predicted before and after, measured; largest nu-gap before and after"""
    next_experiment: dict[str, Any] | None = None
    notes: tuple[str, ...] = field(default=())

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


def sweeps_for(experiment: Experiment) -> tuple[Sweep, Sweep | None, str]:
    """The sweep to fit, the one that no fit sees, and its name; only excited sweeps of the plant count."""
    excited = [
        (k, s)
        for k, s in enumerate(experiment.sweeps)
        if s.kind != "noise" and s.comment not in ("amplifier", "coarse")
    ]
    if not excited:
        raise GapError("the experiment has no excited sweep; run the experiment, then diagnose")
    main = excited[0][1]
    for k, s in excited[1:]:
        return main, s, f"sweeps/{k}"
    return main, None, "every other line of sweeps/0"


def diagnose(experiment: Experiment, datasheet: Datasheet, jobs: int = 1) -> Diagnosis:
    """Diagnose the gap between a rig's experiment and the twin of its datasheet.

    Raises
    ------
    GapError
        The data do not allow it: no excited sweep, too few points or blocks, axes that do not match.
    """
    if experiment.axes != datasheet.axes:
        raise GapError(f"the experiment has axes {list(experiment.axes)}, the datasheet {list(datasheet.axes)}")
    nu = nuisance(datasheet)
    main, other, name = sweeps_for(experiment)
    notes = _notes(main, other, datasheet)
    held_half = None
    if other is None:
        line = np.unique(main.frequency_hz, return_inverse=True)[1]
        main, other = main.select(line % 2 == 0), main.select(line % 2 == 1)
        held_half = other
    o = observe(thinned(main), nu.rig, (0.0, 0.8))
    unseen = observe(thinned(other), nu.rig, (0.8, 1.0))
    if o.unsettled > 0.3:
        notes.append(f"{100 * o.unsettled:.0f} % of the points had not settled; their weight is reduced")
    with Fitter(jobs) as fitter:
        order = _explain(fitter, nu, o)
        if other is not held_half and _fails_on(order[0].candidate, unseen):
            seen, unseen, name = _halves(other, nu, name)
            order = _with_amplitude(fitter, nu, (o, seen), order)
            notes.append("the twin fits the main sweep but not the other: half of the other's lines were fitted too")
    where = locate(nu, (o,), unseen)
    null = next(r.candidate for r in order if not r.candidate.effects)
    closures, gaps = {}, {}
    before = shrinkage(null.fit.rig, null.fit.rig, unseen, name)
    for r in order[:12]:
        after = shrinkage(null.fit.rig, r.candidate.fit.rig, unseen, name)
        closures[r.candidate.effects] = after.closure
        gaps[r.candidate.effects] = relative_gap(r.candidate.fit.rig, unseen)
    z = residual(order[0].candidate.fit.rig, o)
    verdict = decide(order, closures, significance(z, o), before.before)
    chosen = next((r.candidate for r in order if r.candidate.effects == verdict.effects), null)
    shrunk = shrinkage(null.fit.rig, chosen.fit.rig, unseen, name) if verdict.effects else before
    left = _left(order, verdict)
    return Diagnosis(
        experiment.rig,
        where,
        tuple(order),
        verdict,
        shrunk,
        closures,
        relative_gap(null.fit.rig, unseen),
        relative_noise(unseen, nu.rig.n_axes),
        gaps,
        o,
        unseen,
        loop_figures(null.fit.rig, chosen.fit.rig, o),
        next_experiment(nu, left, o),
        tuple(notes),
    )


def _left(order: Sequence[Ranked], verdict: Verdict) -> list[Candidate]:
    """Explanations that are still to be told apart: of one alias class, or of nearly the same evidence."""
    if verdict.kind in ("no_gap", "none_of_these"):
        return []
    names = {group for alternatives in verdict.indistinguishable for group in alternatives}
    best = order[0]
    return [
        r.candidate
        for r in order
        if r.candidate.effects and (set(r.candidate.effects) <= names or r.log_evidence > best.log_evidence - 5.0)
    ][:2]


def _notes(main: Sweep, other: Sweep | None, datasheet: Datasheet) -> list[str]:
    notes = []
    if other is None:
        notes.append(
            "one sweep only: closure is cross-validated over its lines, which is weaker than another condition"
        )
    if main.I is None:
        notes.append("the coil current was not logged: amplifier and plant cannot be told apart, alias classes grow")
    if datasheet.n_axes == 2:
        notes.append("two axes only: effects that couple x and y cannot be seen")
    if not datasheet.tolerance_stated:
        notes.append("the datasheet states no tolerances: this product's defaults are assumed")
    if not datasheet.modes:
        notes.append("the datasheet knows no flexible mode: add the identified ones before the gap is diagnosed")
    return notes


def _explain(fitter: Fitter, nu: Nuisance, o: Observation) -> list[Ranked]:
    """Fit the plain twin, every single effect, and pairs where one effect leaves too much."""
    zero = np.zeros(len(nu))
    null = fitter.run([Task(nu, (o,), (), ((),), zero)])[0]
    probed = fitter.run(
        Task(nu, (o,), (e.id,), tuple((s,) for s in starts(e, null.fit.rig, o)), zero, PROBING)
        for e in possible(nu, (o,))
    )
    singles = _refined(fitter, nu, (o,), probed)
    order = ranked(null, singles)
    if order[0].candidate.effects and order[0].unexplained > MIXED:
        order = _with_pairs(fitter, nu, o, null, singles, order)
    return order


def _fails_on(best: Candidate, unseen: Observation) -> bool:
    """Whether an explanation that fits the main sweep leaves a clear gap on the other one."""
    J = float(per_point(best.fit.rig, unseen).mean())
    return J > VISIBLE and significance(residual(best.fit.rig, unseen), unseen) > SIGNIFICANT


def _halves(other: Sweep, nu: Nuisance, name: str) -> tuple[Observation, Observation, str]:
    """The other sweep in two: even lines to fit, odd lines unseen."""
    line = np.unique(other.frequency_hz, return_inverse=True)[1]
    seen, unseen = (
        observe(thinned(other.select(line % 2 == k)), nu.rig, (0.8, 1.0)) if (line % 2 == k).sum() * 2 > 16 else None
        for k in (0, 1)
    )
    if seen is None or unseen is None:
        whole = observe(thinned(other), nu.rig, (0.8, 1.0))
        return whole, whole, name + " (fitted too)"
    return seen, unseen, name + ", every other line"


def _with_amplitude(
    fitter: Fitter, nu: Nuisance, both: tuple[Observation, ...], order: Sequence[Ranked]
) -> list[Ranked]:
    """Explanations refitted to both sweeps, with effects that only show at another amplitude beside the best ones."""
    zero = np.zeros(len(nu))
    null = fitter.run([Task(nu, both, (), ((),), zero)])[0]
    best = [r.candidate for r in order if r.candidate.effects][:3]
    tasks = [Task(nu, both, c.effects, (c.fit.values,), c.fit.theta, PROBING) for c in best]
    largest = both[-1] if np.abs(both[-1].Y).max() > np.abs(both[0].Y).max() else both[0]
    for effect in (e for e in possible(nu, both) if e.nonlinear):
        found = starts(effect, null.fit.rig, largest)
        tasks.append(Task(nu, both, (effect.id,), tuple((s,) for s in found), null.fit.theta, PROBING))
        for c in best[:2]:
            if effect.id not in c.effects and len(c.effects) == 1:
                pair = tuple((c.fit.values[0], s) for s in found)
                tasks.append(Task(nu, both, (*c.effects, effect.id), pair, c.fit.theta, PROBING))
    everything = ranked(null, _refined(fitter, nu, both, fitter.run(tasks)))
    return [r for r in everything if len(r.candidate.effects) < 2 or _worth_it(r, everything)]


def _refined(
    fitter: Fitter, nu: Nuisance, observations: tuple[Observation, ...], probed: Sequence[Candidate]
) -> list[Candidate]:
    """The probed candidates, the best ones fitted to the end."""
    best = sorted(probed, key=lambda c: c.fit.chi_square + c.fit.penalty)
    tasks = [Task(nu, observations, c.effects, (c.fit.values,), c.fit.theta, (EXACT,)) for c in best[:REFINED]]
    return [*fitter.run(tasks), *best[REFINED:]]


def _with_pairs(
    fitter: Fitter, nu: Nuisance, o: Observation, null: Candidate, singles: Sequence[Candidate], order: list[Ranked]
) -> list[Ranked]:
    best = order[0].candidate
    names = [r.candidate.effects[0] for r in order if r.candidate.effects]
    tasks = []
    for a, b in [(names[0], n) for n in names[1:]] + list(combinations(names[1:PAIRED], 2)):
        first = next(c for c in singles if c.effects == (a,))
        second = starts(CATALOGUE[b], best.fit.rig, o)
        tasks.append(Task(nu, (o,), (a, b), tuple((first.fit.values[0], s) for s in second), best.fit.theta, PROBING))
    pairs = _refined(fitter, nu, (o,), fitter.run(tasks))
    everything = ranked(null, [*singles, *pairs])
    return [r for r in everything if len(r.candidate.effects) < 2 or _worth_it(r, everything)]


def _worth_it(pair: Ranked, order: Sequence[Ranked]) -> bool:
    """Whether both effects of a pair are needed: each alone leaves three times as much, and more than a little."""
    alone = [r for r in order if len(r.candidate.effects) == 1 and r.candidate.effects[0] in pair.candidate.effects]
    least = min((r.unexplained for r in alone), default=1.0)
    a, b = pair.candidate.effects
    alias = b in CATALOGUE[a].aliases or a in CATALOGUE[b].aliases
    return least > (0.15 if alias else MIXED) and pair.unexplained < least / 3
