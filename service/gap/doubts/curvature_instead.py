"""Whether a curved characteristic explains a part better than the effects that do so best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.curved_signal import Seen, curvatures_in_words, systematic
from service.gap.weighing.ranking import noise_levels
from service.gap.weighing.verdict import MAX_SHARE_LEFT
from service.gap.which.curvature import CHI_SQUARE_SHOWN, Curvature, curvatures
from service.gap.which.explained import Explained

Complex = NDArray[np.complex128]


def curved_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """What curvature, in words, explains a part better than the best effects do; None where none does.

    It has to explain more of the fitted sweeps and of the unseen one together, and as much of the fitted ones alone: on
    the unseen one an effect may fail for what else is there. ``plain`` and ``best`` are the sweep that no fit saw and
    what the plain twin and the best explanation leave there, weighted, (P, H, n).
    """
    sweeps = [*zip(e.ground.observations, e.plain, strict=True), plain]
    for better, c in _compared(e, plain, best):
        std = np.hypot(c.std, systematic(sweeps, c.null, c.law))
        if better > 0 and (words := curvatures_in_words(c.law, e.ground.nuisance.rig.axes, c.value, std)):
            return words
    return None


def curved_alike(e: Explained, plain: Seen, best: Seen) -> tuple[str, ...]:
    """Causes of curvatures that explain a part as well as the best effects do: what they lack may be chance."""
    return tuple(c.law.cause for better, c in _compared(e, plain, best) if better > -CHI_SQUARE_SHOWN)


def _compared(e: Explained, plain: Seen, best: Seen) -> list[tuple[float, Curvature]]:
    """Curvatures by what chi-square they explain beyond the best effects, the most first.

    They leave no more of the fitted sweeps than another law of an effect may.
    """
    null, named = e.null.candidate, e.order[0].candidate
    noise = sum(noise_levels(null, [r.candidate for r in e.order]))
    fitted, there = null.fit.cost - named.fit.cost, _power(plain[1]) - _power(best[1])
    enough = max(CHI_SQUARE_SHOWN, (1 - MAX_SHARE_LEFT) * (null.fit.cost - noise), fitted - CHI_SQUARE_SHOWN)
    bent = [c for c in curvatures(e.ground, null, e.plain) if c.explained >= enough]
    by_named = fitted + there
    compared = [(c.explained + c.explained_on(*plain) - by_named, c) for c in bent]
    return sorted(compared, key=lambda one: -one[0])


def _power(z: Complex) -> float:
    return float(np.sum(np.abs(z) ** 2))
