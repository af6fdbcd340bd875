"""The parts of the loop explained one after the other: controller, amplifiers, plant, each on what the others are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from service.gap.doubts.log import faint_log_fault, log_fault
from service.gap.fitting.amplifiers_uncertainty import inherited_from
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.part import Ground, Part, Values, driven_by_current, parts
from service.gap.measured.observation import Observation
from service.gap.observed import Observed
from service.gap.progress import Progress
from service.gap.which.explained import Explained
from service.gap.which.one_more_effect import residuals
from service.gap.which.plant_or_amplifiers import plant_or_amplifiers
from service.gap.which.search import LARGEST_MIXTURE, explain, plain_twin

Real = NDArray[np.float64]

UNDERSTOOD = 4.0
"""Significance of what is left of the amplifiers up to which the plant is held against u through them."""
NOISE_ALONE = 2.0
"""The same for the mean squared residual of a sweep: it counts single lines, of an amplifier at its limit, in full."""


@dataclass
class PartsInTurn:
    """The parts that are explained so far, and what is wrong with the log."""

    fitter: Fitter
    data: Observed
    observations: tuple[Observation, ...]
    before: Mapping[str, Explained] = field(default_factory=dict)
    """by path, what fewer sweeps told of a part"""
    explained: list[Explained] = field(default_factory=list)
    fault: str | None = None

    def explain_all(
        self, progress: Progress, percent: tuple[float, float], known: Mapping[str, Explained] | None = None
    ) -> None:
        """Explain every part; those ``known``, by path, are not looked at again."""
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
        """One part more.

        Where interference is heard aloud, it and not the log is at fault. With a log at fault no mixtures are looked
        for: their effects would not be there.
        """
        ground, sooner = self._ground(part), self.before.get(part.path)
        plain = plain_twin(self.fitter, ground, sooner)
        suspect = part.path == "plant" and not self.data.aloud
        if suspect:
            self.fault = log_fault(self.fitter, self.explained, ground, plain, self.observations)
        result = explain(self.fitter, ground, plain, 1 if self.fault else LARGEST_MIXTURE, sooner)
        if suspect and not self.fault:
            self.fault = faint_log_fault(self.fitter, self.explained, result, result.chosen)
        if ground.inherited is not None and not self.fault:
            result = self._shared_with_amplifiers(result)
        self.explained.append(result)

    def _ground(self, part: Part) -> Ground:
        """What a part is held against: of the plant u through the amplifiers, or the current where they are unclear."""
        theta, found = self._so_far()
        ground = Ground(self.data.nuisance, part, self.observations, theta, found)
        amplifiers = next((e for e in self.explained if e.part.path == "amplifier"), None)
        if part.path != "plant" or amplifiers is None:
            return ground
        if _understood(amplifiers):
            return _through(ground, amplifiers, amplifiers.chosen)
        driven = tuple(driven_by_current(ground.rig(theta), o) for o in self.observations)
        return replace(ground, observations=driven, from_current=True)

    def _so_far(self) -> tuple[Real, tuple[tuple[str, Values], ...]]:
        """Deviations of all values, and the effects with their parameters, as the parts so far have them."""
        theta = self.explained[-1].chosen.fit.theta if self.explained else np.zeros(len(self.data.nuisance))
        return theta, tuple(found for e in self.explained for found in _found(e.chosen))

    def _rebased(self, e: Explained) -> Explained:
        """A part that is not looked at again, where what was found in the other parts has changed.

        The amplifiers' effects are held as they are now: what was uncertain of them before says nothing of these.
        """
        theta, found = self._so_far()
        ground = replace(e.ground, theta=theta, found=found, inherited=None)
        if ground.from_current:
            ground = replace(ground, observations=(driven_by_current(ground.rig(theta), self.data.o),))
        plain, left = (residuals(ground, c) for c in (e.null.candidate, e.order[0].candidate))
        return replace(e, ground=ground, plain=plain, left=left)

    def _shared_with_amplifiers(self, plant: Explained) -> Explained:
        """The plant, once an effect that amplifiers or plant may have is with the one where it explains both better."""
        amplifiers = self.explained[-1]

        def through(candidate: Candidate) -> Ground:
            return _through(plant.ground, amplifiers, candidate)

        self.explained[-1], plant = plant_or_amplifiers(self.fitter, amplifiers, plant, through)
        if self.explained[-1].chosen is amplifiers.chosen:
            return plant
        return explain(self.fitter, through(self.explained[-1].chosen))


def _found(c: Candidate) -> tuple[tuple[str, Values], ...]:
    return tuple(zip(c.effects, c.fit.values, strict=True))


def _through(ground: Ground, amplifiers: Explained, candidate: Candidate) -> Ground:
    """The plant's ground behind an explanation of the amplifiers, with what is uncertain of it."""
    theirs = inherited_from(amplifiers.ground, candidate)
    uncertain = [name for name, _ in theirs.effects]
    fixed = tuple((name, values) for name, values in _found(candidate) if name not in uncertain)
    found = (*amplifiers.ground.found, *fixed)
    return replace(ground, theta=candidate.fit.theta, found=found, inherited=theirs)


def _understood(amplifiers: Explained) -> bool:
    """Whether the plant can be held against u through the amplifiers: what is left of them is noise, in every line."""
    groups = amplifiers.chosen.fit.groups[::2]
    return amplifiers.remaining < UNDERSTOOD and all(chi < NOISE_ALONE * count for chi, count in groups)
