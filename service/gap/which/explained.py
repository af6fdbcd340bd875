"""Result of the search in one part of the loop: its explanations, ranked, and their residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.gap.fitting.candidates import Candidate
from service.gap.fitting.part import Ground, Part
from service.gap.fitting.predict import TINY_SIGNAL, TINY_WEIGHT, measured_signal, weight
from service.gap.measured.observation import Observation
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.significance import significance
from service.gap.which.curvature import Curvature, curvatures
from service.gap.which.moved_modes import MovedModes

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Explained:
    """The explanations of one part."""

    ground: Ground
    order: tuple[Ranked, ...]
    """by falling evidence, the plain twin among them"""
    plain: tuple[Complex, ...]
    """weighted residuals of the plain twin, (P, H, n) per sweep"""
    left: tuple[Complex, ...]
    """weighted residuals of the best explanation, (P, H, n) per sweep"""
    elsewhere: tuple[Ranked, ...] = ()
    """effects of another part that would explain this part's gap about as well; their log evidence is comparable with
    that of ``order``"""
    moved: MovedModes | None = None
    """the twin with modes of the datasheet elsewhere, where that explains as much as the best effects do"""

    @property
    def part(self) -> Part:
        """The part of the loop."""
        return self.ground.part

    @property
    def chosen(self) -> Candidate:
        """The explanation of most evidence, on which the fits of other parts build; it may be the plain twin."""
        return self.order[0].candidate

    @property
    def null(self) -> Ranked:
        """The plain twin."""
        return next(r for r in self.order if not r.candidate.effects)

    @cached_property
    def curvatures(self) -> list[Curvature]:
        """Each possible curved characteristic of the part; several doubts ask for them."""
        return curvatures(self.ground, self.null.candidate, self.plain)

    @property
    def significance(self) -> float:
        """Significance of the gap, a normal deviate."""
        return gap_significance(self.plain, self.ground.observations)

    @property
    def relative_gap(self) -> float:
        """||measured - plain twin|| / ||measured|| of the part's output, fundamental, the largest of the sweeps."""
        sweeps = zip(self.plain, self.ground.observations, strict=True)
        return max(relative_size(z, o, self.part.signal) for z, o in sweeps)

    @property
    def remaining(self) -> float:
        """Significance of the best explanation's residuals, a normal deviate."""
        return max(significance(z, o) for z, o in zip(self.left, self.ground.observations, strict=True))


def relative_size(z: Complex, o: Observation, signal: str) -> float:
    """||residual|| / ||measured|| of a part's output, fundamental; ``z`` are weighted residuals, (P, H, n)."""
    w, f = weight(o, signal), o.fundamental
    size = float(np.linalg.norm(measured_signal(o, signal)[:, f]))
    return float(np.linalg.norm(z[:, f] / np.maximum(w[:, f], TINY_WEIGHT))) / max(size, TINY_SIGNAL)


def gap_significance(plain: Sequence[Complex], observations: Sequence[Observation]) -> float:
    """Significance of the plain twin's residuals at the excited frequency, over bands and channels."""
    return max(significance(z[:, [o.fundamental]], o, bound=np.inf) for z, o in zip(plain, observations, strict=True))
