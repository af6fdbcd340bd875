"""A controller while a campaign holds its lease: made ready, played on while its bus fails, stopped by who cancels."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from secrets import token_hex
from typing import TypeVar

from drivers.controller import (
    Controller,
    PeriodicController,
    PointResult,
    State,
    Tone,
    TripCause,
    Waveform,
    WaveformResult,
)
from drivers.errors import BusError, CancelledError, ControllerError, LatchedTripError, TripError
from service.campaign.multisine.plan import PeriodicRequest
from service.campaign.plan import Request
from service.campaign.recorder import Trip
from service.experiment.errors import CampaignError

T = TypeVar("T")

WATCH_S = 0.1
BUS_TRIES = 6
"""With a pause that doubles from 0.1 s, a bus has three seconds to come back."""
FIRST_PAUSE_S = 0.1
BUS_PATIENCE_S = 60.0
"""and no longer than this in all, each driver's own patience included: then it is told."""
OF_THE_HOST = TripCause.HOST.name.lower()
OF_THE_TONE = (TripCause.DISPLACEMENT.name.lower(), TripCause.CURRENT.name.lower())
"""Causes of trips as `TripError` names them; any other is a fault of the rig."""


def alone(name: str) -> str:
    """A holder's name of its own for each call: devices tell hosts by their names."""
    return f"{name} {token_hex(3)}"


class Patient:
    """Plays tones on a leased controller, and gives a failing bus time to come back."""

    def __init__(self, controller: Controller, cancelled: Callable[[], bool]) -> None:
        self._controller = controller
        self._cancelled = cancelled
        self._failing_since: float | None = None

    def __call__(self, request: Request | PeriodicRequest) -> PointResult | WaveformResult | Trip:
        """One tone or waveform, or how it tripped: a trip that a smaller one may not cause again is acknowledged.

        Raises
        ------
        CampaignError
            The controller tripped of a fault of its own, or between two tones, which is left latched: no tone mends it.
        """
        play = self._player(request)
        self._failing_since = None
        for attempt in range(BUS_TRIES):
            if self._cancelled():
                raise CancelledError("the campaign was cancelled; the excitation is off")
            try:
                return self._through(play)
            except TripError as trip:
                between = isinstance(trip, LatchedTripError) and trip.cause != OF_THE_HOST
                if between or trip.cause not in (*OF_THE_TONE, OF_THE_HOST):
                    raise CampaignError(
                        f"the controller tripped{' while nothing was excited' if between else ''} ({trip}); find the "
                        "cause and acknowledge it, as with ambit acknowledge, then run this again to go on where it "
                        "stopped"
                    ) from trip
                self._through(self._controller.acknowledge)
                if trip.cause != OF_THE_HOST:
                    return Trip(trip.cause, str(trip))
                # a watchdog that tripped says something of the bus, not of the tone
                if attempt == BUS_TRIES - 1 or self._failed_long():
                    raise
        raise AssertionError("the last attempt returns or raises")

    def _player(self, request: Request | PeriodicRequest) -> Callable[[], PointResult | WaveformResult]:
        """What plays the request."""
        if isinstance(request, Request):
            tone = Tone(**asdict(request))
            return lambda: self._controller.measure(tone)
        waveform = Waveform(request.waveform_a, request.periods, request.settle_samples)
        controller = self._controller
        if not isinstance(controller, PeriodicController):
            raise CampaignError("the controller plays no periodic waveforms although its capabilities promise them")
        return lambda: controller.measure_periodic(waveform)

    def _through(self, call: Callable[[], T]) -> T:
        """Result of a call over the bus, tried again while the bus fails."""
        pause = FIRST_PAUSE_S
        for _ in range(BUS_TRIES - 1):
            try:
                return call()
            except BusError:
                if self._failed_long():
                    raise
                time.sleep(pause)
                pause *= 2
        return call()

    def _failed_long(self) -> bool:
        """Whether the bus has failed in this call for as long as one waits for it; the first failure begins that."""
        now = time.monotonic()
        self._failing_since = self._failing_since or now
        return now - self._failing_since >= BUS_PATIENCE_S


def acknowledged(controller: Controller) -> str | None:
    """Clear a latched trip, and tell what it was; None where there is none. Nothing moves.

    Raises
    ------
    LeaseError
        Another host holds the rig.
    """
    status = controller.status()
    if status.state != State.TRIPPED:
        return None
    with controller.lease(alone("ambit acknowledge")):
        controller.acknowledge()
    return status.trip_message or status.trip.name.lower()


def make_ready(controller: Controller) -> None:
    """Refuse a rig that is off or tripped; the trip of a host that went away, as a killed run does, is acknowledged."""
    status = controller.status()
    if status.state == State.TRIPPED:
        if status.trip != TripCause.HOST:
            raise CampaignError(
                f"the controller is tripped ({status.trip_message}); find the cause and acknowledge it first, as with "
                "ambit acknowledge"
            )
        controller.acknowledge()
    if status.state == State.OFF:
        raise CampaignError("the rotor does not levitate: the controller is off; switch it on first")


@contextmanager
def stopped_by(controller: Controller, cancelled: Callable[[], bool] | None) -> Iterator[None]:
    """Watch ``cancelled`` from another thread and, once it is true, say stop until the campaign has ended.

    Said once, it might come just before the next tone begins, or be lost on the bus.
    """
    if cancelled is None:
        yield
        return
    over = threading.Event()

    def watch() -> None:
        while not over.wait(WATCH_S):
            if cancelled():
                with suppress(ControllerError):
                    controller.stop()

    thread = threading.Thread(target=watch, name="campaign-watch", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
