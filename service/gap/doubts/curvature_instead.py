"""Whether a curved characteristic explains a part better than the best effects do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.curved_signal import Seen, curvatures_in_words, systematic
from service.gap.weighing.ranking import noise_levels
from service.gap.weighing.verdict import MAX_SHARE_LEFT
from service.gap.which.curvature import CHI_SQUARE_SHOWN, Curvature
from service.gap.which.explained import Explained

Complex = NDArray[np.complex128]


def curved_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """The curvature, in words, that explains a part better than the best effects do; or None.

    It must explain more of the fitted and the unseen sweeps together, and about as much of the fitted ones alone, as
    the effects may fail on the unseen sweep for another reason. ``plain`` and ``best`` are the unseen sweep with the
    residuals of the plain twin and of the best explanation.
    """
    sweeps = [*zip(e.ground.observations, e.plain, strict=True), plain]
    for better, c in _compared(e, plain, best):
        std = np.hypot(c.std, systematic(sweeps, c.null, c.law))
        if better > 0 and (words := curvatures_in_words(c.law, e.ground.nuisance.rig.axes, c.value, std)):
            return words
    return None


def curved_alike(e: Explained, plain: Seen, best: Seen) -> tuple[str, ...]:
    """Causes of curvatures that explain a part as well as the best effects do, to within chance."""
    return tuple(c.law.cause for better, c in _compared(e, plain, best) if better > -CHI_SQUARE_SHOWN)


def _compared(e: Explained, plain: Seen, best: Seen) -> list[tuple[float, Curvature]]:
    """(chi-square explained beyond what the best effects explain, curvature), the largest first.

    Only curvatures that are clear, that leave no more of the gap than another law of an effect may, and that explain
    about as much of the fitted sweeps as the effects.
    """
    null, named = e.null.candidate, e.order[0].candidate
    noise = sum(noise_levels(null, [r.candidate for r in e.order]))
    on_fitted, on_unseen = null.fit.cost - named.fit.cost, _chi_square(plain[1]) - _chi_square(best[1])
    enough = max(CHI_SQUARE_SHOWN, (1 - MAX_SHARE_LEFT) * (null.fit.cost - noise), on_fitted - CHI_SQUARE_SHOWN)
    clear = [c for c in e.curvatures if c.explained >= enough]
    by_effects = on_fitted + on_unseen
    compared = [(c.explained + c.explained_on(*plain) - by_effects, c) for c in clear]
    return sorted(compared, key=lambda one: -one[0])


def _chi_square(z: Complex) -> float:
    return float(np.sum(np.abs(z) ** 2))
