"""The result of a diagnosis, and which of its explanations are reported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from service.gap.fitting.candidates import Candidate
from service.gap.measured.observation import Observation
from service.gap.weighing.ranking import Ranked
from service.gap.weighing.shrinkage import Shrinkage
from service.gap.weighing.verdict import Verdict
from service.gap.where.where import Where
from service.gap.which.beyond_tolerance import ERRORS_OF_STATED_VALUES

CANDIDATES_REPORTED = 10
"""Number of candidates in the report."""


def listed(order: Sequence[Ranked], chosen: tuple[str, ...], most: int = CANDIDATES_REPORTED) -> list[Ranked]:
    """Explanations for the report: the chosen one, rivals by falling evidence, then those that contain the chosen one.

    The latter are no rivals, and so many that they would crowd out the others.
    """
    effects = [r for r in order if r.candidate.effects]
    if not chosen:
        return effects[:most]
    named = [r for r in effects if r.candidate.effects == chosen]
    more = [r for r in effects if set(chosen) < set(r.candidate.effects)]
    rivals = [r for r in effects if r not in named and r not in more]
    return [*named, *rivals, *more][:most]


def closures_of(
    order: Sequence[Ranked], shrunk: Mapping[tuple[str, ...], Shrinkage], chosen: tuple[str, ...]
) -> dict[tuple[str, ...], float | None]:
    """Closure of each explanation; None with an effect whose strength the fitted data do not determine.

    Example: amplifiers that were not driven to their voltage limit may have any limit above, and the fitted one would
    predict a louder sweep wrongly.
    """
    known = {r.candidate.effects for r in order if not r.open_strength or r.candidate.effects == chosen}
    return {effects: of.closure if effects in known else None for effects, of in shrunk.items()}


def runner_up(order: Sequence[Ranked], chosen: tuple[str, ...]) -> Ranked | None:
    """The best explanation that does not contain the chosen one."""
    rivals = (r for r in order if r.candidate.effects and not set(chosen) <= set(r.candidate.effects))
    return next(rivals, None) if chosen else None


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Everything that a diagnosis found; `service.gap.document` turns it into gap.json."""

    rig: str
    where: Where
    order: tuple[Ranked, ...]
    verdict: Verdict
    shrinkage: Shrinkage
    closures: dict[tuple[str, ...], float | None]
    gap_before: float
    noise_floor: float
    """``gap_before`` of what counts as noise: with `measured.observation.MODEL_FLOOR`, the error of any twin, and the
    mean of a point near a flexible mode counted as one block. A right twin may come nearer (docs/decisions/0008)."""
    gaps_after: dict[tuple[str, ...], float]
    observation: Observation
    held_out: Observation
    loop: dict[str, Any] = field(default_factory=dict)
    """sensitivity peaks per axis: predicted before and after, measured; largest nu-gap before and after"""
    next_experiment: dict[str, Any] | None = None
    notes: tuple[str, ...] = field(default=())
    discrepancy: dict[str, Any] | None = None
    """where nothing explains the gap, its shape over frequency, amplitude and channel"""
    datasheet_off: tuple[str, ...] = ()
    """values by which the datasheet is off beyond doubt in the chosen twin, in words, the farthest first"""
    beyond_tolerance: tuple[str, ...] = ()
    """all values that lie beyond their tolerances there, in the same words"""
    of: dict[str, str] = field(default_factory=dict)
    """digests of the inputs: `origin.origin`"""

    @property
    def within_the_datasheet(self) -> bool:
        """Whether the plain twin explains the data, and an effect is named as its datasheet would be too far off."""
        named = set(self.verdict.effects)
        return bool(named) and named <= set(ERRORS_OF_STATED_VALUES) and self.gap_before <= self.noise_floor

    @property
    def null(self) -> Candidate:
        """The plain twin."""
        return next(r.candidate for r in self.order if not r.candidate.effects)

    @property
    def chosen(self) -> Candidate:
        """The explanation that the verdict names, else the plain twin."""
        return next((r.candidate for r in self.order if r.candidate.effects == self.verdict.effects), self.null)
