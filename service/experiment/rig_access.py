"""A controller as a campaign uses it: every measurement is in the journal before the next begins, once and for all.

A measurement that the journal already has is not made again: a resumed campaign asks the same questions in the same
order, gets the recorded answers at once, and goes on where the journal ends.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.controller import Controller, PointResult, Tone
from drivers.errors import BusError, CancelledError, TripError
from service.experiment.errors import JournalError
from service.experiment.journal import Entry, Journal
from service.experiment.plan import Request
from service.experiment.points import Point

BUS_TRIES = 6
FIRST_PAUSE_S = 0.1

Reduction = Callable[[dict[str, NDArray[np.float64]]], dict[str, Any]]


@dataclass(frozen=True)
class Trip:
    """A tone that tripped instead of giving a point."""

    cause: str
    message: str


class RigAccess:
    """Measures through a journal.

    Parameters
    ----------
    controller
        Leased by the caller.
    journal
        What an earlier run has measured is taken from it.
    cancelled
        Asked before every measurement.
    """

    def __init__(self, controller: Controller, journal: Journal, cancelled: Callable[[], bool]) -> None:
        self._controller = controller
        self._journal = journal
        self._waiting = list(reversed(journal.found))
        self._cancelled = cancelled
        self._rate = controller.capabilities().sample_rate_hz
        self.rig_seconds = 0.0
        self.harmonics: tuple[int, ...] = controller.capabilities().harmonics

    @property
    def replaying(self) -> bool:
        """Whether the next answer comes from the journal."""
        return bool(self._waiting)

    def measure(self, phase: str, request: Request) -> Point | Trip:
        """One tone: a point, or the trip that it ended in (acknowledged)."""
        entry = self._entry(phase, request, None)
        if entry["outcome"] == "trip":
            return Trip(entry["cause"], entry["message"])
        return Point(
            request=request,
            frequency_hz=request.frequency_hz(self._rate),
            R=entry["R"],
            U=entry["U"],
            I=entry["I"],
            Y=entry["Y"],
            peak_displacement_m=entry["peak_displacement_m"],
            peak_current_a=entry["peak_current_a"],
            time_s=entry["time_s"],
        )

    def reduce(self, phase: str, request: Request, reduction: Reduction) -> dict[str, Any] | Trip:
        """One tone with its records, of which only ``reduction(records)`` is kept."""
        entry = self._entry(phase, request, reduction)
        if entry["outcome"] == "trip":
            return Trip(entry["cause"], entry["message"])
        result: dict[str, Any] = entry["reduced"]
        return result

    def _entry(self, phase: str, request: Request, reduction: Reduction | None) -> Entry:
        asked = {"phase": phase, "request": asdict(request)}
        if self._waiting:
            entry = self._waiting.pop()
            if {k: entry.get(k) for k in asked} != asked:
                raise JournalError(
                    f"{self._journal.path} was written by another plan: its next point is {entry.get('request')}, "
                    f"this one asks for {asked['request']}; start anew without resuming"
                )
        else:
            if self._cancelled():
                raise CancelledError("the campaign was cancelled; the excitation is off")
            entry = asked | self._live(request, reduction)
            self._journal.append(entry)
        self.rig_seconds = entry["time_s"]
        return entry

    def _live(self, request: Request, reduction: Reduction | None) -> Entry:
        try:
            result = self._patiently(request)
        except TripError as trip:
            self._controller.acknowledge()
            return {
                "outcome": "trip",
                "cause": trip.cause,
                "message": str(trip),
                "time_s": self.rig_seconds + request.seconds(self._rate),
            }
        entry: Entry = {
            "outcome": "point",
            "peak_displacement_m": float(result.peak_displacement_m),
            "peak_current_a": float(result.peak_current_a),
            "time_s": self.rig_seconds + float(result.rig_seconds),
        }
        if reduction is None:
            return entry | {"R": result.R, "U": result.U, "I": result.I, "Y": result.Y}
        records = result.records
        assert records is not None, "the controller promised records"
        return entry | {"reduced": reduction(records)}

    def _patiently(self, request: Request) -> PointResult:
        """Measure; a failing bus, or a watchdog that it let trip, is given time to come back."""
        tone = Tone(**asdict(request))
        pause = FIRST_PAUSE_S
        for _ in range(BUS_TRIES - 1):
            try:
                return self._controller.measure(tone)
            except BusError:
                time.sleep(pause)
            except TripError as trip:
                if trip.cause != "host":
                    raise
                time.sleep(pause)
                self._controller.acknowledge()
            pause *= 2
        return self._controller.measure(tone)
