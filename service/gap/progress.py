"""Progress of a diagnosis: the parts of the loop, weighted by the fits that they need."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from service.gap.fitting.part import Part
from sim.wording import in_words

ProgressCallback = Callable[[float, str], None]
"""(percent done, never falling; what is done now, in words)"""

STAGES = {"plant": 3}
"""Stages of a fit of a part; one of other parts, which have no resonances."""
FIRST_ROUND = 0.9
"""Share of a part's time for its plain twin and single effects; the number of mixtures after them is not known."""


class Progress:
    """Counts fits, and reports how far the diagnosis is.

    Parameters
    ----------
    progress
        Called after every fit; None for no callback.
    """

    def __init__(self, progress: ProgressCallback | None) -> None:
        self._progress = progress
        self._begin, self._end = 0.0, 0.0
        self._single, self._fits, self._words = 1, 0, ""

    def part(self, part: Part, of: Sequence[Part], begin: float, end: float) -> None:
        """Start a part, in a pass over the parts ``of`` that takes from ``begin`` to ``end`` percent."""
        shares = [(1 + len(p.effects)) * STAGES.get(p.path, 1) for p in of]
        k = [p.path for p in of].index(part.path)
        self._begin, self._end = (begin + (end - begin) * sum(shares[:n]) / sum(shares) for n in (k, k + 1))
        self._single, self._fits = 1 + len(part.effects), 0
        self._words = f"explaining the {part.path}"
        self._tell(self._begin, self._words)

    def fitted(self) -> None:
        """Count one more fit of the part."""
        self._fits += 1
        rounds = self._fits / self._single
        share = FIRST_ROUND * rounds if rounds <= 1 else 1 - (1 - FIRST_ROUND) / rounds
        self._tell(self._begin + share * (self._end - self._begin), f"{self._words}, {self._fits} fitted")

    def without(self, effects: Sequence[str], percent: float) -> None:
        """Start a diagnosis of the twin without some of its effects, of unknown duration."""
        self._begin = self._end = percent
        self._words = f"the twin without {' and '.join(map(in_words, effects))}"
        self._tell(percent, self._words)

    def judging(self, percent: float) -> None:
        """All fits are done."""
        self._tell(percent, "judging on unseen data")

    def _tell(self, percent: float, sentence: str) -> None:
        if self._progress is not None:
            self._progress(percent, sentence)
