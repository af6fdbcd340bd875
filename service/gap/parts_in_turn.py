"""The parts of the loop explained in turn: controller, amplifiers, plant, each with what was found before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.log import faint_log_fault, log_fault
from service.gap.doubts.still_ringing import LARGEST_LEFT_OUT, ringing_lines_hz, without_lines
from service.gap.fitting.amplifiers_uncertainty import inherited_from
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.part import Ground, Part, Values, parts
from service.gap.fitting.plant_input import LawError
from service.gap.measured.observation import Observation
from service.gap.observed import Observed
from service.gap.progress import Progress
from service.gap.weighing.verdict import rejected
from service.gap.which.explained import Explained
from service.gap.which.one_more_effect import residuals
from service.gap.which.plant_or_amplifiers import plant_or_amplifiers
from service.gap.which.search import LARGEST_MIXTURE, explain, plain_twin

Real = NDArray[np.float64]

UNDERSTOOD = 4.0
"""Significance of the amplifiers' residuals up to which the plant is predicted from u through them..."""
NOISE_ALONE = 2.0
"""... and their mean square in a sweep, in which single lines, as of an amplifier at its limit, count in full."""


@dataclass
class PartsInTurn:
    """The parts explained so far, and what is wrong with the log."""

    fitter: Fitter
    data: Observed
    observations: tuple[Observation, ...]
    before: Mapping[str, Explained] = field(default_factory=dict)
    """by path, results on fewer sweeps"""
    explained: list[Explained] = field(default_factory=list)
    fault: str | None = None
    """what is wrong with the log, in words"""

    left_out_hz: list[float] = field(default_factory=list)
    """lines of the main sweep without which the plant is explained, as the rig still rang there"""

    def __post_init__(self) -> None:
        self.fault = self.data.wrong_channels

    def explain_all(
        self, progress: Progress, percent: tuple[float, float], known: Mapping[str, Explained] | None = None
    ) -> None:
        """Explain every part, but for those that are ``known``, by path."""
        known = known or {}
        all_parts = parts(self.data.nuisance, self.observations)
        looked_at = [part for part in all_parts if part.path not in known]
        for part in all_parts:
            if part.path in known:
                self.explained.append(self._rebased(known[part.path]))
            else:
                progress.part(part, looked_at, *percent)
                self._explain(part)

    def _explain(self, part: Part) -> None:
        """Explain one more part.

        With the plant, the log is tested, unless loud interference may be the cause. With a log at fault no mixtures
        are searched for, as their effects would not be there.
        """
        ground, before = self._ground(part), self.before.get(part.path)
        plain = plain_twin(self.fitter, ground, before)
        test_log = part.path == "plant" and not self.data.detected_by_size
        if test_log and not self.fault:
            self.fault = log_fault(self.fitter, self.explained, ground, plain, self.observations)
        result = explain(self.fitter, ground, plain, 1 if self.fault else LARGEST_MIXTURE, before)
        if test_log and not self.fault:
            self.fault = faint_log_fault(self.fitter, self.explained, result, result.chosen)
        if ground.inherited is not None and not self.fault:
            result = self._shared_with_amplifiers(result)
        if part.path == "plant" and not self.fault and not _accepted(result):
            result = self._without_ringing_lines(result)
        self.explained.append(result)

    def _ground(self, part: Part) -> Ground:
        """The ground of a part; the plant's input is u through the amplifiers, or i where these are not understood."""
        theta, found = self._so_far()
        ground = Ground(self.data.nuisance, part, self.observations, theta, found)
        amplifiers = next((e for e in self.explained if e.part.path == "amplifier"), None)
        if part.path != "plant" or amplifiers is None:
            return ground
        if _understood(amplifiers):
            ground = _through(replace(ground, law_error=_law_error(amplifiers)), amplifiers, amplifiers.chosen)
        else:
            ground = replace(ground, from_current=True)
        return replace(ground, observations=tuple(map(ground.as_input, self.observations)))

    def _so_far(self) -> tuple[Real, tuple[tuple[str, Values], ...]]:
        """The nuisance vector, and the effects with their parameters, as found in the parts so far."""
        theta = self.explained[-1].chosen.fit.theta if self.explained else np.zeros(len(self.data.nuisance))
        return theta, tuple(found for e in self.explained for found in _found(e.chosen))

    def _rebased(self, e: Explained) -> Explained:
        """A part that is not explained again, on what was now found in the other parts.

        The amplifiers' effects are held at their present values, as an inherited posterior would be of former ones.
        """
        theta, found = self._so_far()
        ground = replace(e.ground, theta=theta, found=found, inherited=None)
        if ground.part.path == "plant":
            ground = replace(ground, observations=(ground.as_input(self.data.o),))
        plain, left = (residuals(ground, c) for c in (e.null.candidate, e.order[0].candidate))
        return replace(e, ground=ground, plain=plain, left=left)

    def _shared_with_amplifiers(self, plant: Explained) -> Explained:
        """The plant, with an effect moved to the amplifiers if an alias of it there explains both parts better."""
        amplifiers = self.explained[-1]

        def through(candidate: Candidate) -> Ground:
            return _through(plant.ground, amplifiers, candidate)

        self.explained[-1], plant = plant_or_amplifiers(self.fitter, amplifiers, plant, through)
        if self.explained[-1].chosen is amplifiers.chosen:
            return plant
        return explain(self.fitter, through(self.explained[-1].chosen))

    def _without_ringing_lines(self, plant: Explained) -> Explained:
        """The plant explained without a few lines at which the rig still rang, where that names an effect.

        A resonance that the plan did not know of still shows beside them.
        """
        lines = ringing_lines_hz(plant)
        if not 0 < len(lines) <= LARGEST_LEFT_OUT:
            return plant
        without = explain(self.fitter, without_lines(plant.ground, lines))
        if not (_accepted(without) and without.chosen.effects):
            return plant
        self.left_out_hz = lines
        return without


def _accepted(e: Explained) -> bool:
    """Whether the fitted sweeps do not reject the best explanation."""
    return not rejected(e.order[0], e.remaining)


def _found(c: Candidate) -> tuple[tuple[str, Values], ...]:
    """The effects of a candidate with their parameters."""
    return tuple(zip(c.effects, c.fit.values, strict=True))


def _through(ground: Ground, amplifiers: Explained, candidate: Candidate) -> Ground:
    """The plant's ground with the amplifiers as a candidate explains them, and their posterior as a prior."""
    inherited = inherited_from(amplifiers.ground, candidate)
    uncertain = [name for name, _ in inherited.effects]
    fixed = tuple((name, values) for name, values in _found(candidate) if name not in uncertain)
    found = (*amplifiers.ground.found, *fixed)
    return replace(ground, theta=candidate.fit.theta, found=found, inherited=inherited)


def _law_error(amplifiers: Explained) -> LawError | None:
    """What the amplifiers' effects leave of their gap, if anything."""
    best = amplifiers.order[0]
    if not best.candidate.effects or best.unexplained <= 0:
        return None
    return LawError(amplifiers.null.candidate.fit.rig, best.candidate.fit.rig, min(best.unexplained, 1.0))


def _understood(amplifiers: Explained) -> bool:
    """Whether the amplifiers' residuals are noise, so that the plant can be predicted from u through them."""
    groups = amplifiers.chosen.fit.groups[::2]
    return amplifiers.remaining < UNDERSTOOD and all(chi < NOISE_ALONE * count for chi, count in groups)
