"""Whether a mode that changes with its own amplitude explains a plant better than the best effects do."""

from __future__ import annotations

import numpy as np

from service.gap.doubts.curved_signal import Seen
from service.gap.weighing.ranking import noise_levels
from service.gap.weighing.verdict import MAX_SHARE_LEFT
from service.gap.which.changing_mode import ChangingMode, changing_mode
from service.gap.which.explained import Explained

CHI_SQUARE_MORE = 36.0
"""Chi-square by which it must explain more than the effects, and that it must explain at all, as for a curvature."""
SAID = 0.2
"""Ratio of the smaller change to the larger one, of frequency and damping in half widths of the peak, from which both
are stated."""


def changing_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """The changing mode, in words, that explains a plant better than the best effects do; or None.

    ``plain`` and ``best`` are the unseen sweep with the residuals of the plain twin and of the best explanation. Only
    fundamentals are compared there.
    """
    null, named = e.null.candidate, e.order[0].candidate
    noise, f = sum(noise_levels(null, [r.candidate for r in e.order])), plain[0].fundamental
    unseen_plain, unseen_best = (float(np.sum(np.abs(z[:, f]) ** 2)) for z in (plain[1], best[1]))
    excess = null.fit.cost - noise
    if e.part.path != "plant" or excess < CHI_SQUARE_MORE:
        return None
    changing = changing_mode(e.ground, null)
    if changing is None or changing.explained < max(CHI_SQUARE_MORE, (1 - MAX_SHARE_LEFT) * excess):
        return None
    by_effects = null.fit.cost - named.fit.cost + unseen_plain - unseen_best
    better = changing.explained + changing.explained_on(*plain) > by_effects + CHI_SQUARE_MORE
    return _in_words(changing) if better else None


def _in_words(c: ChangingMode) -> str:
    changes = {
        f"its frequency by {100 * c.frequency_change:+.2g} %": abs(c.frequency_change) / c.damping_ratio,
        f"its damping ratio by {c.damping_change:+.2g}": abs(c.damping_change) / c.damping_ratio,
    }
    by_size = sorted(changes, key=lambda words: -changes[words])
    stated = [words for words in by_size if changes[words] >= SAID * max(changes.values())]
    return (
        f"the mode at {c.frequency_hz:.4g} Hz changes with its own swing, as where a joint slips or opens: "
        f"{' and '.join(stated)} at the largest"
    )
