"""Is the datasheet of another rig: its values would have to be off by more than its tolerances allow."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground
from service.gap.fitting.unknowns import TOLERANCE_BOUND
from service.gap.weighing.verdict import SURE_OF_NONE, Verdict
from sim.wording import in_words

IMPLAUSIBLE = 5.0
"""Normal deviate of the datasheet's errors in units of its tolerances, chi-square, from which it is of another rig."""
HOPELESS = 0.35
"""Share of the values that are as far off as any may be, whichever effect is beside them, from which no more are looked
for. Where it was least, it was at most 0.03 on rigs with two gross effects, and 0.4 to 0.65 with datasheets of other
rotors."""


STRANGE = 0.03
"""Relative gap from which a datasheet that is far off is another rig's: those of other rotors leave 0.09 to 0.17 at
their bounds. What draws its values away for less is something in this rig that nothing describes."""


def at_bound(fit: Fit) -> NDArray[np.bool_]:
    """Which of the values fitted are as far off as any may be, (a,)."""
    return np.asarray(np.abs(fit.theta[fit.active]) > 0.999 * TOLERANCE_BOUND)


def hopeless(ground: Ground, fits: Iterable[Fit]) -> bool:
    """Whether every explanation leaves so many values as far off as any may be that no further effect would mend it."""
    own = len(ground.part.active)
    return own > 0 and all(int(at_bound(fit)[:own].sum()) >= HOPELESS * own for fit in fits)


def far_off(ground: Ground, fit: Fit) -> str | None:
    """Which of the datasheet's values are off, in words, where they are farther than its tolerances allow."""
    own, names = ground.part.active, ground.nuisance.names
    k, off = len(own), ground.nuisance.price(fit.theta[own])
    if off <= k + IMPLAUSIBLE * np.sqrt(2 * k):
        return None
    away = ground.nuisance.off(fit.theta)
    worst = sorted(own, key=lambda j: -abs(fit.theta[j]))[:3]
    told = ", ".join(f"{in_words(names[j])} by {away[j]:+z.1f}" for j in worst)
    return f"its values would be off, or apart where they are alike in a rig, by many tolerances ({told})"


def astray(verdict: Verdict, away: str, relative_gap: float) -> Verdict:
    """The verdict on a part whose datasheet would be off by more than it can be: ``away``, in words.

    ``relative_gap`` is what the plain twin leaves of the part's output.
    """
    if relative_gap >= STRANGE and not verdict.bent:
        reason = f"the datasheet seems to be of another rig; {away}: check it"
        return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,), another_rig=True)
    if not verdict.effects:
        return replace(verdict, reasons=(*verdict.reasons, f"beside that, {away}: check the datasheet"))
    words = " and ".join(map(in_words, verdict.effects))
    reason = f"the best explanation, {words}, holds only with a datasheet that is not this rig's; {away}"
    return Verdict("none_of_these", (), (), SURE_OF_NONE, (reason,))
