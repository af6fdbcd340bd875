"""A single effect that leaves little, in place of a likelier explanation that leaves too much to be named.

Another program's law of an effect differs from the catalogue's, and what is left of a gross gap is far beyond noise. A
mixture, or an effect that leaves more at the fundamental but less of faint harmonics, can then have more evidence and
still leave more than its kind may, so that nothing would be named though one effect explains most of the gap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from service.gap.weighing.ranking import Ranked, renormalised
from service.gap.weighing.verdict import rejected

DEMOTED = 15.0
"""Log evidence below the effect named at which rejected explanations are listed: beyond any alias class."""


def accepted_instead(order: Sequence[Ranked], remaining: float) -> list[Ranked]:
    """The order with the likeliest acceptable single effect first, where its first explanation is rejected.

    ``remaining`` is the significance of that explanation's residuals, a normal deviate.
    """
    best = order[0]
    if not best.candidate.effects or not rejected(best, remaining):
        return list(order)
    singles = [r for r in order if len(r.candidate.effects) == 1]
    named = next((r for r in singles if not _leaves_too_much(r)), None)
    if named is None:
        return list(order)
    lowered = named.log_evidence - DEMOTED
    rest = [
        replace(r, log_evidence=min(r.log_evidence, lowered)) if _leaves_too_much(r) else r
        for r in order
        if r is not named
    ]
    return renormalised([named, *sorted(rest, key=lambda r: -r.log_evidence)])


def _leaves_too_much(r: Ranked) -> bool:
    """Whether an explanation is rejected where all that it leaves is significant, as it is beside a gross gap."""
    return rejected(r, math.inf)
