"""Whether a mode that changes with its own swing explains a plant better than the effects that do so best."""

from __future__ import annotations

import numpy as np

from service.gap.doubts.curved_signal import Seen
from service.gap.weighing.ranking import noise_levels
from service.gap.weighing.verdict import MAX_SHARE_LEFT
from service.gap.which.changing_mode import ChangingMode, changing_mode
from service.gap.which.explained import Explained

CHI_SQUARE_MORE = 36.0
"""Chi-square by which it has to explain more, and that it has to explain at all: as a curvature is proven from."""
SAID = 0.2
"""Share of the larger change, of frequency or damping in half widths of the peak, from which the other is told after
it."""


def changing_instead(e: Explained, plain: Seen, best: Seen) -> str | None:
    """Which mode's change, in words, explains a plant better than the best effects do; None where none does.

    ``plain`` and ``best`` are the sweep that no fit saw and what the plain twin and the best explanation leave there,
    weighted, (P, H, n); of it the excited frequency counts.
    """
    null, named = e.null.candidate, e.order[0].candidate
    noise, f = sum(noise_levels(null, [r.candidate for r in e.order])), plain[0].fundamental
    there, left_there = (float(np.sum(np.abs(z[:, f]) ** 2)) for z in (plain[1], best[1]))
    excess = null.fit.cost - noise
    if e.part.path != "plant" or excess < CHI_SQUARE_MORE:
        return None
    changing = changing_mode(e.ground, null)
    if changing is None or changing.explained < max(CHI_SQUARE_MORE, (1 - MAX_SHARE_LEFT) * excess):
        return None
    by_named = null.fit.cost - named.fit.cost + there - left_there
    better = changing.explained + changing.explained_on(*plain) > by_named + CHI_SQUARE_MORE
    return _in_words(changing) if better else None


def _in_words(c: ChangingMode) -> str:
    changes = {
        f"its frequency by {100 * c.frequency_change:+.2g} %": abs(c.frequency_change) / c.damping_ratio,
        f"its damping ratio by {c.damping_change:+.2g}": abs(c.damping_change) / c.damping_ratio,
    }
    by_size = sorted(changes, key=lambda words: -changes[words])
    told = [words for words in by_size if changes[words] >= SAID * max(changes.values())]
    return (
        f"the mode at {c.frequency_hz:.4g} Hz changes with its own swing, as where a joint slips or opens: "
        f"{' and '.join(told)} at the largest"
    )
