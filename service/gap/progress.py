"""How far a diagnosis is: the parts of the loop, weighed by the fits that they need."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from service.gap.fitting.part import Part
from sim.wording import in_words

ProgressCallback = Callable[[float, str], None]
"""Told the percent that are done, never falling, and what is done now, in words."""

STAGES = {"plant": 3}
"""Stages of a fit; of the other parts, one: they have no resonances."""
FIRST_ROUND = 0.9
"""Share of a part's time that its plain twin and single effects take; mixtures come after, of unknown number."""


class Progress:
    """Counts fits, and tells how far the diagnosis is.

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
        """A part begins, of a pass over the parts that takes from ``begin`` to ``end`` percent."""
        shares = [(1 + len(p.effects)) * STAGES.get(p.path, 1) for p in of]
        k = [p.path for p in of].index(part.path)
        self._begin, self._end = (begin + (end - begin) * sum(shares[:n]) / sum(shares) for n in (k, k + 1))
        self._single, self._fits = 1 + len(part.effects), 0
        self._words = f"explaining the {part.path}"
        self._tell(self._begin, self._words)

    def fitted(self) -> None:
        """One more explanation of the part was fitted."""
        self._fits += 1
        rounds = self._fits / self._single
        share = FIRST_ROUND * rounds if rounds <= 1 else 1 - (1 - FIRST_ROUND) / rounds
        self._tell(self._begin + share * (self._end - self._begin), f"{self._words}, {self._fits} fitted")

    def without(self, effects: Sequence[str], percent: float) -> None:
        """The twin is diagnosed without some of its effects; how long that takes is not known before."""
        self._begin = self._end = percent
        self._words = f"the twin without {' and '.join(map(in_words, effects))}"
        self._tell(percent, self._words)

    def judging(self, percent: float) -> None:
        """All fits are done."""
        self._tell(percent, "judging on unseen data")

    def _tell(self, percent: float, sentence: str) -> None:
        if self._progress is not None:
            self._progress(percent, sentence)
