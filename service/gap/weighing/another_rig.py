"""Is the datasheet of another rig: its values would have to be off by more than its tolerances allow."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.fit import TOLERANCE_BOUND
from service.gap.fitting.fitted import Fit
from service.gap.fitting.part import Ground

IMPLAUSIBLE = 5.0
"""Normal deviate of the datasheet's errors in units of its tolerances, chi-square, from which it is of another rig."""
HOPELESS = 0.35
"""Share of the values that are as far off as any may be, whichever effect is beside them, from which no more are looked
for. Where it was least, it was at most 0.03 on rigs with two gross effects, and 0.4 to 0.65 with datasheets of other
rotors."""


def at_bound(fit: Fit) -> NDArray[np.bool_]:
    """Which of the values fitted are as far off as any may be, (a,)."""
    return np.asarray(np.abs(fit.theta[fit.active]) > 0.999 * TOLERANCE_BOUND)


def hopeless(ground: Ground, fits: Iterable[Fit]) -> bool:
    """Whether every explanation leaves so many values as far off as any may be that no further effect would mend it."""
    own = len(ground.part.active)
    return own > 0 and all(int(at_bound(fit)[:own].sum()) >= HOPELESS * own for fit in fits)


def other_rig(ground: Ground, fit: Fit) -> str | None:
    """Why the datasheet cannot be this rig's, in words: even beside the best explanation its values are far off."""
    own, names = ground.part.active, ground.nuisance.names
    k, off = len(own), ground.nuisance.price(fit.theta[own])
    if off <= k + IMPLAUSIBLE * np.sqrt(2 * k):
        return None
    away = ground.nuisance.off(fit.theta)
    worst = sorted(own, key=lambda j: -abs(fit.theta[j]))[:3]
    told = ", ".join(f"{names[j].replace('_', ' ')} by {away[j]:+z.1f}" for j in worst)
    return (
        "the datasheet seems to be of another rig; its values would be off, or apart where they are alike in a rig, "
        f"by many tolerances ({told}): check it"
    )
