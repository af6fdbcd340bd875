"""The affordable experiment that best separates what is left.

Every option is the profile that would be submitted. The service's own campaign is rehearsed with it on the twin of the
chosen explanation, and both explanations predict what a diagnosis would get of it. The option whose outcome most likely
tells them apart wins.
"""

from __future__ import annotations

import json
import shlex
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


def next_experiment(
    nuisance: Nuisance, pair: tuple[Candidate, Candidate] | None, grounds: Grounds, name: str, fitter: Fitter
) -> dict[str, Any] | None:
    """The option that tells two explanations apart, or None where there are none or nothing affordable does.

    Of those that are nearly sure to, one without work by hand before one with, and then the one that needs the least
    time of the rig; else the one that is most likely to. What takes work by hand is rehearsed only where nothing else
    is nearly sure. The answer has the tones, and the command and the job that ask the service for them. ``name`` is the
    rig's.
    """
    if pair is None:
        return None
    a, b = pair
    there_are = [o for o in options(grounds.sweeps, a.fit.rig, grounds.limits) if not only_fainter(o, a, b)]
    what_it_tells = partial(_told, nuisance, a, b, grounds)
    ranking: list[_Told] = []
    for by_hand in (False, True):  # work by hand is not looked at where something else is nearly sure to do
        told = fitter.over(what_it_tells, [o for o in there_are if bool(o.by_hand) is by_hand])
        ranking += [t for t in told if t is not None and t.odds >= WORTH]
        if any(t.odds >= SURE for t in ranking):
            break
    ranking.sort(key=_Told.order)
    if not ranking:
        return None
    best = ranking[0]
    option = best.case.option
    return {
        "separates": ["+".join(c.effects) or "none" for c in (a, b)],
        "experiment": option.name,
        "description": option.description,
        **best.figures(),
        "speed_rad_s": option.speed_rad_s,
        "set_point_share_of_gap": option.offset,
        "tones": tones(best.case, a.fit.rig.axes),
        "by_hand": list(option.by_hand),
        **submission(option, name),
        "alternatives": [{"experiment": other.case.option.name, **other.figures()} for other in ranking[1:]],
    }


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
