"""Whether a curved characteristic explains a part better than the effects that do so best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.curved import Seen, in_words, systematic
from service.gap.weighing.verdict import UNEXPLAINED, noise_levels
from service.gap.which.curvature import curvatures
from service.gap.which.search import Explained

Complex = NDArray[np.complex128]


def curved_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """What curvature, in words, explains a part better than the best effects do; None where none does.

    It has to explain more of the fitted sweeps and of the unseen one together, and may leave no more of the fitted ones
    than another law of an effect. ``plain`` and ``best`` are the sweep that no fit saw and what the plain twin and the
    best explanation leave there, weighted, (P, H, n).
    """
    null, named = e.null.candidate, e.order[0].candidate
    noise = sum(noise_levels(null, [r.candidate for r in e.order]))
    enough = (1 - UNEXPLAINED) * (null.fit.cost - noise)
    bent = [c for c in curvatures(e.ground, null, e.plain) if c.explained >= enough]
    by_all = sorted(((c.explained + c.explained_on(*plain), c) for c in bent), key=lambda one: -one[0])
    by_named = null.fit.cost - named.fit.cost + _power(plain[1]) - _power(best[1])
    sweeps = [*zip(e.ground.observations, e.plain, strict=True), plain]
    for explained, c in by_all:
        std = np.hypot(c.std, systematic(sweeps, null, c.law))
        if explained > by_named and (reason := in_words(c.law, e.ground.nuisance.rig.axes, c.value, std)):
            return reason
    return None


def _power(z: Complex) -> float:
    return float(np.sum(np.abs(z) ** 2))
