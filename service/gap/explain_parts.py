"""Every part of the loop explained: on the main sweep, then with half of the other where that does not hold there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.gap.doubts.curved_signal import curved_signal
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.measured.observation import Observation
from service.gap.observed import Observed
from service.gap.parts_in_turn import PartsInTurn
from service.gap.progress import Progress
from service.gap.weighing.another_rig import hopeless
from service.gap.weighing.significance import OUTLIER, SIGNIFICANT, alone_hz, mean_power, significance
from service.gap.weighing.verdict import MAX_SHARE_LEFT, VISIBLE_J, rejected
from service.gap.which.explained import Explained
from service.gap.which.held_out import held_out, on_sweep
from sim.effects import CATALOGUE

PERCENT_ONE_SWEEP, PERCENT_FITTED = 80.0, 97.0
"""Percent that are done when the main sweep is explained, and when every fit is done."""
CHI_SQUARE_BEYOND_CHANCE = 36.0
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


def explain_parts(data: Observed, fitter: Fitter, progress: Progress) -> Found:
    """The explanations of every part of the loop."""
    main = PartsInTurn(fitter, data, (data.o,))
    main.explain_all(progress, (0.0, PERCENT_FITTED if data.lines_only else PERCENT_ONE_SWEEP))
    of_main = Found(tuple(main.explained), main.fault, data.unseen, data.name)
    if data.lines_only or main.fault:
        return of_main
    undecided = [e for e in main.explained if not _decided(e)]
    failing = {e.part.path: e for e in undecided if _fails_on(e, data.unseen)}
    alone = {e.part.path: hz for e in undecided if (hz := _fails_alone_hz(e, data.unseen))}
    if not failing and not alone:
        return of_main
    halved = data.halves(next(iter(alone.values()), None))
    if halved is None:
        note = "the twin fits the main sweep but not the other, which has too few lines to fit half of it too"
        return replace(of_main, notes=(note,))
    seen, unseen, name = halved
    failing |= {e.part.path: e for e in undecided if e.part.path in alone}
    known = {e.part.path: e for e in main.explained if e.part.path not in failing}
    both = PartsInTurn(fitter, data, (data.o, seen), before=failing)
    both.explain_all(progress, (PERCENT_ONE_SWEEP, PERCENT_FITTED), known)
    note = "the twin fits the main sweep but not the other: half of the other's lines were fitted too"
    return Found(tuple(both.explained), both.fault, unseen, name, (note,))


def _decided(e: Explained) -> bool:
    """Whether more data explain no more: the main sweep rejects what explains it best, or is of another rig."""
    return rejected(e.order[0], e.remaining) or hopeless(e.ground, (r.candidate.fit for r in e.order))


def _fails_on(e: Explained, unseen: Observation) -> bool:
    """Whether what explains the main sweep leaves a clear gap on the other one, or would be rejected by it.

    Or a curvature there, where nothing explains the main one: of a stop that few lines reach it may be all that shows.
    """
    o, z = on_sweep(e, e.chosen, unseen)
    clear = mean_power(z) > VISIBLE_J and significance(z, o) > SIGNIFICANT
    bent = not e.chosen.effects and curved_signal(e, (o, z)) is not None
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
    return any(left - _left(e, c, unseen) > CHI_SQUARE_BEYOND_CHANCE for c in more)


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
    return hz if np.sum(np.abs(z[at]) ** 2) > MAX_SHARE_LEFT * np.sum(np.abs(plain[at]) ** 2) else None
