"""One verdict from everything that was found: the parts of the loop, interference, the log, and how the rig settled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.gap.compose import heard_too, verdict_of
from service.gap.doubts.across import Across, across_alike
from service.gap.interference import Interference
from service.gap.measured.observation import Observation
from service.gap.measured.settling import UNSETTLED
from service.gap.weighing.verdict import LARGEST_CLASS, UNEXPLAINED, Verdict
from service.gap.which.held_out import between_lines, held_out
from service.gap.which.search import Explained
from sim.effects import CATALOGUE

UNDECIDED = 0.5
"""Probability of a verdict that says nothing either way."""


def judged(
    found: Sequence[Explained],
    o: Observation,
    unseen: Observation,
    gap: float,
    sources: Sequence[Interference] = (),
    fault: str | None = None,
    lines_only: bool = False,
) -> Verdict:
    """The verdict.

    Parameters
    ----------
    gap
        Of the plain twin on the fitted sweep, relative.
    fault
        What is wrong with the log.
    lines_only
        Whether the unseen points are other lines of the fitted sweep.
    """
    there = {e.part.path: held_out(e, unseen) for e in found}
    if lines_only:
        there = {e.part.path: between_lines(e, unseen, there[e.part.path]) for e in found}
    verdict = verdict_of(found, there, unseen)
    verdict = with_across(verdict, [a for e in found for a in across_alike(e)])
    verdict = heard_too(verdict, sources)
    if fault is not None:
        verdict = Verdict("none_of_these", (), (), 0.9, (fault,))
    if verdict.kind != "no_gap" and (why := not_settled(o, gap)):
        verdict = Verdict("none_of_these", (), (), UNDECIDED, (why,), settled=False)
    return verdict


def with_across(verdict: Verdict, alike: Sequence[Across]) -> Verdict:
    """The verdict with what couples x and y and would look alike, where the data are of one plane."""
    if not alike:
        return verdict
    if verdict.kind == "none_of_these":
        told = (f"with two axes, {a.words} would look like it" for a in alike)
        return replace(verdict, reasons=(*verdict.reasons, *told))
    of_plant = [name for name in verdict.effects if CATALOGUE[name].path == "plant"]
    if len(of_plant) != 1:
        return verdict
    group = next((g for g in verdict.indistinguishable if of_plant[0] in g), (of_plant[0],))
    others = tuple(g for g in verdict.indistinguishable if of_plant[0] not in g)
    wider = (of_plant[0], *(a.effect for a in alike), *(name for name in group if name != of_plant[0]))
    return replace(verdict, indistinguishable=(wider[:LARGEST_CLASS], *others))


def not_settled(o: Observation, gap: float) -> str | None:
    """Why nothing can be said of a gap: most points drift, by more than another law of an effect may leave."""
    if o.unsettled <= UNSETTLED:
        return None
    change = o.drift[o.drifting]
    if np.sqrt(np.mean(change**2)) < UNEXPLAINED * gap:
        return None
    return (  # where an answer is small its drift is large beside it: of such points the mean is
        f"the rig did not settle: {100 * o.unsettled:.0f} % of the points still drift from block to block, half of "
        f"them by more than {100 * np.median(change):.2g} %; let it settle longer before each point and measure again"
    )
