"""Every measurement is in the journal before the next one begins, and is never made twice.

A resumed campaign asks the same questions in the same order. As long as the journal has answers they are returned at
once, and the rig rests; where it ends, the rig goes on. No driver is known here: whoever moves the rig hands over a
function.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from service.campaign.journal import ANEW, Entry
from service.campaign.multisine.plan import PeriodicRequest
from service.campaign.plan import Request
from service.campaign.points import Point
from service.experiment.errors import CampaignError, JournalError

Reduction = Callable[[dict[str, NDArray[np.float64]]], dict[str, Any]]
Asked = TypeVar("Asked", bound=Request | PeriodicRequest)


@dataclass(frozen=True)
class Trip:
    """A tone that tripped instead of giving a point; acknowledged."""

    cause: str
    message: str
    request: Request | None = None
    """The tone, as the journal has it; None from whoever moves the rig."""


class Played(Protocol):
    """What the rig gives for whatever it played."""

    @property
    def peak_displacement_m(self) -> float:
        """Largest |y|, ramps included; NaN where the controller tells none."""

    @property
    def peak_current_a(self) -> float:
        """Largest |i|, ramps included; NaN likewise."""

    @property
    def rig_seconds(self) -> float:
        """Rig time that it took, s."""


class Answer(Played, Protocol):
    """What the rig gave for a tone: the fields of `drivers.controller.PointResult` that are kept."""

    @property
    def R(self) -> NDArray[np.complex128]:
        """Excitation, (blocks, H, n_axes), A."""

    @property
    def U(self) -> NDArray[np.complex128]:
        """Control current, shape as `R`, A."""

    @property
    def I(self) -> NDArray[np.complex128]:  # noqa: E743
        """Coil current, shape as `R`, A."""

    @property
    def Y(self) -> NDArray[np.complex128]:
        """Displacement, shape as `R`, m."""

    @property
    def records(self) -> dict[str, NDArray[np.float64]] | None:
        """Signals by name, (N, n_axes) each; None when they were not asked for."""


class PeriodicAnswer(Played, Protocol):
    """What the rig gave for a waveform: the fields of `drivers.controller.WaveformResult` that are kept."""

    @property
    def records(self) -> dict[str, NDArray[np.float64]]:
        """Signals by name, (N, n_axes) each."""


class Recorder:
    """Measures through a journal.

    Parameters
    ----------
    measure
        Plays one tone on the rig, or says how it tripped.
    found
        Entries of the journal of an earlier run.
    append
        Puts an entry in the journal.
    sample_rate_hz, harmonics
        Of the controller.
    speed
        At which the rotor turns, rad/s, asked before each measurement; None where that is not known.
    anew
        What whoever runs the campaign can do where the journal is of another plan.
    """

    def __init__(
        self,
        measure: Callable[[Request | PeriodicRequest], Answer | PeriodicAnswer | Trip],
        found: list[Entry],
        append: Callable[[Entry], None],
        sample_rate_hz: float,
        harmonics: tuple[int, ...],
        speed: Callable[[], float | None] = lambda: None,
        anew: str = ANEW,
    ) -> None:
        self._measure = measure
        self._speed = speed
        self.anew = anew
        self._append = append
        self._found = list(reversed(found))
        self._rate = sample_rate_hz
        self.harmonics = harmonics
        self.rig_seconds = 0.0
        """Rig time spent so far, by this run and by those that it goes on from."""

    @property
    def replaying(self) -> bool:
        """Whether the next answer comes from the journal."""
        return bool(self._found)

    def point(self, phase: str, request: Request, keep_trip: bool = True) -> Point | Trip:
        """One tone: a point, or the trip in which it ended; its request is what was measured, as the journal has it.

        A trip is kept in the journal, as part of what the rig answered, unless ``keep_trip`` is False: then a resumed
        campaign asks again.
        """
        request, entry = self._answered(phase, request, None, keep_trip)
        if entry["outcome"] == "trip":
            return Trip(entry["cause"], entry["message"], request)
        return Point(
            request=request,
            frequency_hz=request.frequency_hz(self._rate),
            R=entry["R"],
            U=entry["U"],
            I=entry["I"],
            Y=entry["Y"],
            peak_displacement_m=_number(entry["peak_displacement_m"]),
            peak_current_a=_number(entry["peak_current_a"]),
            time_s=entry["time_s"],
            speed_rad_s=entry.get("speed_rad_s"),
        )

    def reduced(self, phase: str, request: Request | PeriodicRequest, reduction: Reduction) -> dict[str, Any] | Trip:
        """One tone or waveform with its records, of which ``reduction(records)``, peaks and speed are kept."""
        _, entry = self._answered(phase, request, reduction, request.amplitude_a > 0)
        if entry["outcome"] == "trip":
            return Trip(entry["cause"], entry["message"])
        peaks = {k: _number(entry[k]) for k in ("peak_displacement_m", "peak_current_a")}
        return {**entry["reduced"], **peaks, "speed_rad_s": entry.get("speed_rad_s")}

    def _answered(
        self, phase: str, request: Asked, reduction: Reduction | None, keep_trip: bool
    ) -> tuple[Asked, Entry]:
        """What was asked, and the answer.

        A campaign may go on where another processor began it, whose last digits ask a hair otherwise. What was
        measured is what the journal says, and all that follows from it follows from that.
        """
        if self._found:
            entry = self._found.pop()
            recalled = request.recalled(entry.get("request")) if entry.get("phase") == phase else None
            if recalled is None:
                raise JournalError(
                    f"the journal was written by another plan: its next point is {entry.get('request')} "
                    f"({entry.get('phase')}), this one asks for {request.description()} ({phase}); {self.anew}"
                )
            request = cast(Asked, recalled)  # of the same kind
        else:
            entry = {"phase": phase, "request": request.description()} | self._live(request, reduction)
            if keep_trip or entry["outcome"] != "trip":
                self._append(entry)
        self.rig_seconds = entry["time_s"]
        return request, entry

    def _live(self, request: Request | PeriodicRequest, reduction: Reduction | None) -> Entry:
        speed = self._speed()
        answer = self._measure(request)
        if isinstance(answer, Trip):
            return {
                "outcome": "trip",
                "cause": answer.cause,
                "message": answer.message,
                "time_s": self.rig_seconds + request.seconds(self._rate),
            }
        entry: Entry = {
            "outcome": "point",
            "peak_displacement_m": _or_null(answer.peak_displacement_m),
            "peak_current_a": _or_null(answer.peak_current_a),
            "time_s": self.rig_seconds + float(answer.rig_seconds),
            "speed_rad_s": speed,
        }
        if reduction is None:
            tone = cast(Answer, answer)  # a waveform is always reduced
            return entry | {"R": tone.R, "U": tone.U, "I": tone.I, "Y": tone.Y}
        if answer.records is None:
            raise CampaignError("the controller sent no records although its capabilities promise them")
        return entry | {"reduced": reduction(answer.records)}


def _or_null(peak: float) -> float | None:
    """A peak for the journal: null for one that is no number, for which nothing that was measured is lost."""
    return float(peak) if math.isfinite(peak) else None


def _number(peak: float | None) -> float:
    """The inverse."""
    return math.nan if peak is None else float(peak)
