"""Explanations of every part of the loop: on the main sweep, and with half of the other one where they fail there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.gap.doubts.curved_signal import curved_signal
from service.gap.doubts.still_ringing import hertz
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.measured.observation import Observation
from service.gap.observed import Observed
from service.gap.parts_in_turn import PartsInTurn
from service.gap.progress import Progress
from service.gap.weighing.another_rig import hopeless
from service.gap.weighing.significance import OUTLIER, SIGNIFICANT, alone_hz, mean_power, significance
from service.gap.weighing.verdict import MAX_SHARE_LEFT, VISIBLE_J, rejected
from service.gap.which.explained import Explained, relative_size
from service.gap.which.held_out import held_out, on_sweep
from sim.effects import CATALOGUE

PERCENT_ONE_SWEEP, PERCENT_FITTED = 80.0, 97.0
"""Percent done when the main sweep is explained, and when all parts are."""
CHI_SQUARE_BEYOND_CHANCE = 36.0
"""Chi-square that a prediction must take off unseen data. Without the effect, a predicted change of x standard
deviations takes off 2 n x - x^2, where noise has n standard deviations along it: n would have to be 6 or more, for any
x."""

FAR_LARGER = 5.0
"""Ratio of a part's relative gaps, other sweep over main one, from which the other one is explained for its own sake,
though the main one rejects every explanation."""


@dataclass(frozen=True)
class Found:
    """The explanations of all parts of the loop, and the data that stay unseen."""

    parts: tuple[Explained, ...]
    fault: str | None
    """what is wrong with the log, in words"""
    unseen: Observation
    name: str
    """of ``unseen``"""
    notes: tuple[str, ...] = ()


def explain_parts(data: Observed, fitter: Fitter, progress: Progress) -> Found:
    """The explanations of every part of the loop."""
    main = PartsInTurn(fitter, data, (data.o,))
    main.explain_all(progress, (0.0, PERCENT_FITTED if data.lines_only else PERCENT_ONE_SWEEP))
    of_main = Found(tuple(main.explained), main.fault, data.unseen, data.name, _left_out(main))
    if data.lines_only or main.fault:
        return of_main
    undecided = [e for e in main.explained if not _decided(e) or is_of_other_sweep(e, data.unseen)]
    failing = {e.part.path: e for e in undecided if _fails_on(e, data.unseen)}
    failing_line_hz = {e.part.path: hz for e in undecided if (hz := _fails_alone_hz(e, data.unseen))}
    if not failing and not failing_line_hz:
        return of_main
    halved = data.halves(next(iter(failing_line_hz.values()), None))
    if halved is None:
        note = "the twin fits the main sweep but not the other, which has too few lines to fit half of it too"
        return replace(of_main, notes=(*of_main.notes, note))
    to_fit, unseen, name = halved
    failing |= {e.part.path: e for e in undecided if e.part.path in failing_line_hz}
    known = {e.part.path: e for e in main.explained if e.part.path not in failing}
    both = PartsInTurn(fitter, data, (data.o, to_fit), before=failing)
    both.explain_all(progress, (PERCENT_ONE_SWEEP, PERCENT_FITTED), known)
    fits = all(e.part.path not in failing or not _decided(e) for e in main.explained)
    why = "the twin fits the main sweep but not the other" if fits else "the gap is far larger on the other sweep"
    note = f"{why}: half of the other's lines were fitted too"
    return Found(tuple(both.explained), both.fault, unseen, name, (*_left_out(both), note))


def _left_out(found: PartsInTurn) -> tuple[str, ...]:
    """A note on lines without which the plant is explained."""
    if not found.left_out_hz:
        return ()
    return (
        f"the plant is explained without {hertz(found.left_out_hz)}, where the rig still rang from block to block: a "
        "narrow resonance there needs a longer wait; measure those lines again",
    )


def _decided(e: Explained) -> bool:
    """Whether more data would not help: the main sweep rejects its best explanation, or is of another rig.

    Also where the datasheet has modes in the wrong place, beside which any explanation fails elsewhere.
    """
    return (
        e.moved is not None
        or rejected(e.order[0], e.remaining)
        or hopeless(e.ground, (r.candidate.fit for r in e.order))
    )


def is_of_other_sweep(e: Explained, unseen: Observation) -> bool:
    """Whether the part's gap is so much larger on the other sweep that what the main one shows is another matter.

    A supply's limit may show on the louder sweep alone, beside a law of the amplifiers that is off a little on both.
    """
    o, z = on_sweep(e, e.null.candidate, unseen)
    there, here = (relative_size(*sweep, e.part.signal) for sweep in ((z, o), (e.plain[0], e.ground.observations[0])))
    return significance(z, o) > SIGNIFICANT and there > FAR_LARGER * here


def _fails_on(e: Explained, unseen: Observation) -> bool:
    """Whether the explanation of the main sweep leaves a clear gap on the other one, or is rejected by it.

    Also, without an effect, whether the other sweep shows a curvature: a stop that few lines reach may show no more.
    """
    o, z = on_sweep(e, e.chosen, unseen)
    clear = mean_power(z) > VISIBLE_J and significance(z, o) > SIGNIFICANT
    curved = not e.chosen.effects and curved_signal(e, (o, z)) is not None
    return clear or curved or held_out(e, unseen).fails or shown_by_other_sweep(e, unseen)


def shown_by_other_sweep(e: Explained, unseen: Observation) -> bool:
    """Whether a further nonlinear effect, fitted to the main sweep, predicts the other one beyond chance.

    On the main sweep it may not be worth its price in evidence, and on the other the mean of a band may hide it.
    """
    best = e.chosen
    larger = (
        r.candidate
        for r in e.order
        if set(r.candidate.effects) > set(best.effects)
        and any(CATALOGUE[name].nonlinear for name in set(r.candidate.effects) - set(best.effects))
    )
    chi_square = _chi_square(e, best, unseen)
    return any(chi_square - _chi_square(e, c, unseen) > CHI_SQUARE_BEYOND_CHANCE for c in larger)


def _chi_square(e: Explained, candidate: Candidate, unseen: Observation) -> float:
    """Chi-square of an explanation on unseen data; an outlier counts up to a bound."""
    _, z = on_sweep(e, candidate, unseen)
    return float(np.minimum(np.abs(z) ** 2, 2 * OUTLIER).sum())


def _fails_alone_hz(e: Explained, unseen: Observation) -> float | None:
    """The line of the other sweep, Hz, that shows a gap by itself, as of a limit or a stop (`alone_hz`); or None.

    None also where the plant's effects explain as much of that line as their law in another program would.
    """
    o, z = on_sweep(e, e.chosen, unseen)
    hz = alone_hz(e.part, z, o)
    if hz is None or e.part.path == "amplifier" or not e.chosen.effects:
        return hz
    at = o.points_hz == hz
    _, plain = on_sweep(e, e.null.candidate, unseen)
    return hz if np.sum(np.abs(z[at]) ** 2) > MAX_SHARE_LEFT * np.sum(np.abs(plain[at]) ** 2) else None
