"""Whether a curved displacement or current explains a part better than the effects that do so best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.curved import Seen, in_words, systematic
from service.gap.weighing.verdict import UNEXPLAINED, noise_levels
from service.gap.which.curved_signal import curved_signal
from service.gap.which.search import Explained

Complex = NDArray[np.complex128]


def curved_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """What curvature, in words, explains a part better than the best effects do; None where none does.

    It has to explain more of the fitted sweeps and of the unseen one together, and may leave no more of the fitted ones
    than another law of an effect. ``plain`` and ``best`` are the sweep that no fit saw and what the plain twin and the
    best explanation leave there, weighted, (P, H, n).
    """
    null, named = e.null.candidate, e.order[0].candidate
    bent = curved_signal(e.ground, null, e.plain)
    if bent is None:
        return None
    noise = sum(noise_levels(null, [r.candidate for r in e.order]))
    if bent.explained < (1 - UNEXPLAINED) * (null.fit.cost - noise):
        return None
    by_named = null.fit.cost - named.fit.cost + _power(plain[1]) - _power(best[1])
    if bent.explained + bent.explained_on(*plain) <= by_named:
        return None
    sweeps = [*zip(e.ground.observations, e.plain, strict=True), plain]
    std = np.hypot(bent.std, systematic(sweeps, null, e.part.signal))
    return in_words(e.part.signal, e.ground.nuisance.rig.axes, bent.value, std)


def _power(z: Complex) -> float:
    return float(np.sum(np.abs(z) ** 2))
