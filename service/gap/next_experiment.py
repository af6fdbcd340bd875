"""The affordable experiment that best separates what is left.

Every option is the profile that would be submitted. The service's own campaign is rehearsed with it on the twin of the
chosen explanation, and both explanations predict what a diagnosis would get of it. The option whose outcome most likely
tells them apart wins.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from service.distributions import normal_tail
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.nuisance import Nuisance
from service.gap.proposal.case import Case, Grounds, case
from service.gap.proposal.options import Option, options
from service.gap.proposal.separation import separations
from sim.effects import CATALOGUE
from sim.errors import AmbError

WORTH, SURE = 0.75, 0.95
"""Odds from which an experiment is worth its time, half-way from a coin's to certainty, and from which a better one is
not worth more time."""
BY_HAND = 0.05
"""What an experiment that takes work by hand must add to the odds of one that takes none."""


@dataclass(frozen=True)
class _Told:
    """What an option's experiment would tell."""

    case: Case
    distances: tuple[float, float]
    """in standard deviations, where the one explanation is true and where the other is"""

    @property
    def odds(self) -> float:
        """Probability that the true one explains the outcome better, either as likely to be true."""
        return float(np.mean([normal_tail(-d / 2) for d in self.distances]))

    def order(self) -> tuple[bool, bool, float]:
        """To sort by, the best one first."""
        by_hand = bool(self.case.option.by_hand)
        if self.odds < SURE:
            return True, False, BY_HAND * by_hand - self.odds
        return False, by_hand, self.case.rig_seconds

    def figures(self) -> dict[str, float]:
        """As gap.json has them; of the two distances the smaller one."""
        return {
            "distance_sd": min(self.distances),
            "odds_of_telling_apart": self.odds,
            "rig_seconds": self.case.rig_seconds,
        }


def _told(nuisance: Nuisance, a: Candidate, b: Candidate, grounds: Grounds, option: Option) -> _Told | None:
    """What an option would tell of two explanations; None where it has been measured or cannot be."""
    try:
        one = case(option, a.fit.rig, nuisance.rig, grounds)
        return None if one is None else _Told(one, separations(nuisance, a, b, one.main, one.option))
    except (AmbError, ValueError, np.linalg.LinAlgError):
        return None  # this rig cannot be brought to that condition


def only_fainter(option: Option, a: Candidate, b: Candidate) -> bool:
    """Whether an option has less amplitude for two explanations that answer in proportion to it."""
    apart = set(a.effects) ^ set(b.effects)
    return option.amplitude is not None and option.amplitude < 1 and not any(CATALOGUE[e].nonlinear for e in apart)


class Proposal:
    """The option that tells two explanations apart, looked for by the fitter's processes while others go on.

    Of those that are nearly sure to, one without work by hand before one with, and then the one that needs the least
    time of the rig; else the one that is most likely to. What takes work by hand is rehearsed only where nothing else
    is nearly sure. The answer has the tones, and the command and the job that ask the service for them.
    """

    def __init__(
        self, nuisance: Nuisance, pair: tuple[Candidate, Candidate], grounds: Grounds, name: str, fitter: Fitter
    ) -> None:
        """Begin to look; ``name`` is the rig's."""
        self._pair, self._name, self._fitter = pair, name, fitter
        self._what_it_tells = partial(_told, nuisance, *pair, grounds)
        there_are = options(grounds.sweeps, pair[0].fit.rig, grounds.limits)
        self._options = [o for o in there_are if not only_fainter(o, *pair)]
        self._begun = self._told(by_hand=False)

    def _told(self, by_hand: bool) -> Iterator[_Told | None]:
        return self._fitter.over(self._what_it_tells, [o for o in self._options if bool(o.by_hand) is by_hand])

    def document(self) -> dict[str, Any] | None:
        """As gap.json has it, once it is found; None where nothing affordable tells them apart."""
        ranking = _worth(self._begun)
        if not any(t.odds >= SURE for t in ranking):
            ranking += _worth(self._told(by_hand=True))
        if not ranking:
            return None
        best, *others = sorted(ranking, key=_Told.order)
        option = best.case.option
        return {
            "separates": ["+".join(c.effects) or "none" for c in self._pair],
            "experiment": option.name,
            "description": option.description,
            **best.figures(),
            "speed_rad_s": option.speed_rad_s,
            "set_point_share_of_gap": option.offset,
            "tones": tones(best.case, self._pair[0].fit.rig.axes),
            "by_hand": list(option.by_hand),
            **submission(option, self._name),
            "alternatives": [{"experiment": other.case.option.name, **other.figures()} for other in others],
        }


def _worth(told: Iterable[_Told | None]) -> list[_Told]:
    return [t for t in told if t is not None and t.odds >= WORTH]


def tones(planned: Case, axes: tuple[str, ...]) -> list[dict[str, Any]]:
    """What the campaign is expected to play in the sweeps that a diagnosis uses."""
    return [
        {
            "sweep": sweep,
            "axis": axes[p.request.axis],
            "frequency_hz": p.frequency_hz,
            "amplitude_a": p.request.amplitude_a,
        }
        for sweep in ("main", "validation")
        for p in sorted(planned.points.get(sweep, ()), key=lambda p: (p.frequency_hz, p.request.axis))
    ]


def submission(option: Option, name: str) -> dict[str, Any]:
    """The command and the API's job that run an option; the API wants the rig's id, the command knows names too.

    Nothing is identified of it: it is for the diagnosis, and may have too narrow a band.
    """
    chosen: dict[str, Any] = {"profile": dict(option.profile), "identify": False}
    words = " ".join(f"--option {shlex.quote(f'{k}={json.dumps(v)}')}" for k, v in chosen.items())
    return {
        "command": f"ambit submit experiment --rig {shlex.quote(name)} {words}",
        "job": {"kind": "experiment", "rig": "<id of the rig>", "options": chosen},
    }
