"""The next experiment: the affordable one that best separates two remaining explanations.

Every option is a profile as it would be submitted. The service's own campaign is rehearsed with it on the twin of the
chosen explanation, and both explanations predict the data that a diagnosis would get. The option whose data most likely
separate them wins.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from service.distributions import normal_tail
from service.gap.fitting.candidates import Candidate, Fitter
from service.gap.fitting.nuisance import Nuisance
from service.gap.fitting.part import STANDSTILL
from service.gap.proposal.case import Grounds, case
from service.gap.proposal.options import Option, options
from service.gap.proposal.rehearsal import Rehearsal
from service.gap.proposal.safety import require_levitation
from service.gap.proposal.separation import separations
from service.gap.which.rivals import turning_with_the_shaft
from sim.effects import CATALOGUE
from sim.errors import AmbError

WORTH, SURE = 0.75, 0.95
"""Odds from which an experiment is worth its time, half-way between a coin's and certainty, and from which better odds
are not worth more time."""
BY_HAND = 0.05
"""Odds that an experiment with work by hand must have more than one without."""


@dataclass(frozen=True)
class _Outlook:
    """How well an option's experiment would separate two explanations."""

    option: Option
    """as it is submitted"""
    campaign: Rehearsal
    distances: tuple[float, float]
    """of the predictions, in standard deviations, if the one explanation is true and if the other is"""

    @property
    def odds(self) -> float:
        """As `odds` of the distances."""
        return odds(self.distances)

    def order(self) -> tuple[bool, bool, float]:
        """Sort key, the best one first."""
        by_hand = bool(self.option.by_hand)
        if self.odds < SURE:
            return True, False, BY_HAND * by_hand - self.odds
        return False, by_hand, self.campaign.rig_seconds

    def figures(self) -> dict[str, float]:
        """As in gap.json; of the two distances the smaller one."""
        return {
            "distance_sd": min(self.distances),
            "odds_of_telling_apart": self.odds,
            "rig_seconds": self.campaign.rig_seconds,
        }


def odds(distances: tuple[float, float]) -> float:
    """Probability that the true explanation explains the outcome better, with even prior odds.

    ``distances`` are in standard deviations, as of `service.gap.proposal.separation.separations`.
    """
    return float(np.mean([normal_tail(-d / 2) for d in distances]))


def _outlook(
    nuisance: Nuisance, a: Candidate, b: Candidate, grounds: Grounds, option: Option, others: Sequence[Candidate] = ()
) -> _Outlook | None:
    """How well an option would separate two explanations; None where it is not worth its time or cannot be measured.

    Nor where it brings the rotor to a condition in which one of them does not levitate, or one of the ``others``.
    """
    try:
        if option.new_condition(grounds.sweeps):
            require_levitation(option.rig(c.fit.rig) for c in (a, b, *others))
        planned = case(option, a.fit.rig, nuisance.rig, grounds)
        if planned is None:
            return None
        distances = separations(nuisance, a, b, planned.main, planned.option)
        return _Outlook(planned.option, planned.campaign.whole(), distances) if odds(distances) >= WORTH else None
    except (AmbError, ValueError, np.linalg.LinAlgError):
        return None  # this rig cannot be brought to that condition


def turning_damping(pair: Sequence[Candidate]) -> list[Candidate]:
    """Twins with damping that turns with the shaft in place of the same that stands still: at rest nobody knows which.

    Such a rotor can become unstable at a speed that it holds with the other, whatever else is to be told apart.
    """
    found = [turning_with_the_shaft(c) for c in pair if not STANDSTILL.keys().isdisjoint(c.effects)]
    return [c for c in found if c is not None]


def only_fainter(option: Option, a: Candidate, b: Candidate) -> bool:
    """Whether an option only has less amplitude, where the effects that two explanations differ in are linear."""
    apart = set(a.effects) ^ set(b.effects)
    return option.amplitude is not None and option.amplitude < 1 and not any(CATALOGUE[e].nonlinear for e in apart)


class Proposal:
    """The option that separates two explanations, searched for by the fitter's processes while the diagnosis goes on.

    Of options that are nearly sure to separate them, one without work by hand is preferred, then the one of least time;
    else the one of the best odds. Options with work by hand are rehearsed only where no other is nearly sure. The
    proposal has the tones, and the command and the job that submit the experiment.

    No option brings the rotor to where an explanation in question says that it does not levitate.
    """

    def __init__(
        self,
        nuisance: Nuisance,
        pair: tuple[Candidate, Candidate],
        grounds: Grounds,
        name: str,
        fitter: Fitter,
        others: Sequence[Candidate] = (),
    ) -> None:
        """Start the search; ``name`` is the rig's, and ``others`` are in question beside the pair."""
        self._pair, self._name, self._fitter = pair, name, fitter
        others = [*others, *turning_damping([*pair, *others])]
        self._outlook_of = partial(_outlook, nuisance, *pair, grounds, others=others)
        rig, *rivals = (c.fit.rig for c in (*pair, *others))
        all_options = options(grounds.sweeps, rig, grounds.limits, rivals, nuisance.rig)
        self._options = [o for o in all_options if not only_fainter(o, *pair)]
        self._started = self._outlooks(by_hand=False)

    def _outlooks(self, by_hand: bool) -> Iterator[_Outlook | None]:
        return self._fitter.over(self._outlook_of, [o for o in self._options if bool(o.by_hand) is by_hand])

    def document(self) -> dict[str, Any] | None:
        """The proposal as in gap.json, once it is found; None where no affordable option separates them."""
        ranking = [t for t in self._started if t is not None]
        if not any(t.odds >= SURE for t in ranking):
            ranking += [t for t in self._outlooks(by_hand=True) if t is not None]
        if not ranking:
            return None
        best, *others = sorted(ranking, key=_Outlook.order)
        option = best.option
        return {
            "separates": ["+".join(c.effects) or "none" for c in self._pair],
            "experiment": option.name,
            "description": option.description,
            **best.figures(),
            "speed_rad_s": option.speed_rad_s,
            "set_point_share_of_gap": option.offset,
            "tones": tones(best.campaign, self._pair[0].fit.rig.axes),
            "by_hand": list(option.by_hand),
            **submission(option, self._name),
            "alternatives": [{"experiment": other.option.name, **other.figures()} for other in others],
        }


def tones(campaign: Rehearsal, axes: tuple[str, ...]) -> list[dict[str, Any]]:
    """Tones that the campaign is expected to play in the sweeps that a diagnosis uses."""
    return [
        {
            "sweep": sweep,
            "axis": axes[p.request.axis],
            "frequency_hz": p.frequency_hz,
            "amplitude_a": p.request.amplitude_a,
        }
        for sweep in ("main", "validation")
        for p in sorted(campaign.points.get(sweep, ()), key=lambda p: (p.frequency_hz, p.request.axis))
    ]


def submission(option: Option, name: str) -> dict[str, Any]:
    """The command and the API's job that run an option; the API takes the rig's id, the command also its name.

    No identification is asked for, as the band may be too narrow for one.
    """
    chosen: dict[str, Any] = {"profile": dict(option.profile), "identify": False}
    words = " ".join(f"--option {shlex.quote(f'{k}={json.dumps(v)}')}" for k, v in chosen.items())
    return {
        "command": f"ambit submit experiment --rig {shlex.quote(name)} {words}",
        "job": {"kind": "experiment", "rig": "<id of the rig>", "options": chosen},
    }
