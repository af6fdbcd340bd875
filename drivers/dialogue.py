"""Talking to one device over its links: retries, refusals explained, stale answers and restarts told apart."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from drivers.controller import TripCause
from drivers.errors import (
    BusError,
    CancelledError,
    ControllerError,
    LatchedTripError,
    LeaseError,
    LimitError,
    RestartError,
    StopRefusedError,
)
from drivers.link import Link, LinkFactory, RefusedError
from drivers.objects import BY_NAME, Refusal
from drivers.packing import Value, Values, encode
from drivers.values import coded, number, whole

T = TypeVar("T")

REFUSALS_BELIEVED = 4
"""A refusal that nothing explains is asked for again this often: it may have been a corrupted frame."""
COUNT_BELIEVED = 4
"""So many statuses in a row, each older than the newest but newer than the one before it, are from a count that began
anew: a vendor's may have few bits, or no boot_id beside it."""
STOP_PATIENCE_S = 1.0
LAST_TRIES_S = 0.2
"""Seconds for which a failing bus is still tried once the caller wants to stop: on a line that all share, the stop may
itself have spoilt an answer, and the next one says that the excitation is off."""


class Dialogue:
    """One host's conversation with one device.

    Parameters
    ----------
    links
        Connections to the device.
    patience_s
        How long a call keeps trying on a failing bus.
    """

    def __init__(self, links: LinkFactory, patience_s: float) -> None:
        self.links = links
        self.link: Link = links.link()
        self.token = 0
        """Of the lease that this host holds; 0 for none."""
        self.holder = ""
        self.boot_id = 0
        """Of the device when it was leased."""
        self.impatient = threading.Event()
        """Set when the caller wants to stop: then a failing bus is given up."""
        self._patience_s = patience_s
        self._lock = threading.RLock()
        self._urgent: Link = links.link(urgent=True)
        self._urgent_lock = threading.Lock()
        self._snapshot = (0, 0)
        self._older: list[int] = []
        """Snapshots that were refused one after the other, rising."""

    def close(self) -> None:
        """Give up the links; safe twice."""
        for link in (self.link, self._urgent):
            with suppress(Exception):
                link.close()
        with suppress(Exception):
            self.links.close()

    def patiently(self, action: Callable[[Link], T], patience_s: float | None = None) -> T:
        """Result of an action, tried again with growing pauses while the bus fails."""
        deadline = time.monotonic() + (self._patience_s if patience_s is None else patience_s)
        given_up_at, pause = math.inf, 0.005
        while True:
            try:
                with self._lock:
                    return action(self.link)
            except BusError as error:
                if time.monotonic() + pause > deadline:
                    raise BusError(f"{self.links.description}: {error}") from error
                if self.impatient.is_set():
                    given_up_at = min(given_up_at, time.monotonic() + LAST_TRIES_S)
                if time.monotonic() + pause > given_up_at:
                    raise CancelledError(
                        "stopped while the bus was failing; the controller's watchdog ends the excitation"
                    ) from error
                time.sleep(pause)
                pause = min(2 * pause, 0.5)

    def read(self, group: str, patience_s: float | None = None) -> dict[str, Value]:
        """Snapshot of a group."""
        return self.patiently(lambda link: readable(lambda: link.read(group)), patience_s)

    def status(self, expect_boot: bool = True, patience_s: float | None = None) -> dict[str, Value]:
        """The device's status, younger than any before.

        Raises
        ------
        RestartError
            The device has restarted since it was leased, and that is expected not to be.
        """

        def fresh(link: Link) -> dict[str, Value]:
            values = readable(lambda: link.read("status"))
            boot, snapshot = (whole(values.get(name, 0), f"status.{name}") for name in ("boot_id", "snapshot"))
            if "snapshot" in values and boot == self._snapshot[0] and self._is_older(snapshot):
                raise BusError("the controller answered with an older status")
            self._snapshot = (boot, snapshot)
            return values

        values = self.patiently(fresh, patience_s)
        if expect_boot and self.token:
            self.require_same_boot(values)
        return values

    def _is_older(self, snapshot: int) -> bool:
        """Whether a snapshot is from before the newest one, and not of a count that has begun anew since."""
        if snapshot <= self._snapshot[1]:
            self._older = [*(self._older if self._older[-1:] < [snapshot] else []), snapshot]
            if len(self._older) < COUNT_BELIEVED:
                return True
        self._older = []
        return False

    def require_same_boot(self, values: Values) -> None:
        """Raise `RestartError` when these values come from another start of the device than the lease does."""
        if self.boot_id and "boot_id" in values and values["boot_id"] != self.boot_id:
            raise RestartError(
                f"{self.links.description}: the controller restarted while it was leased; the excitation is off and "
                "nothing of before is valid: take the lease again"
            )

    def command(self, group: str, values: dict[str, Value], patience_s: float | None = None) -> None:
        """Write a command; a refusal is explained from the status, or believed when it is repeated."""
        for attempt in range(REFUSALS_BELIEVED):
            try:
                self.patiently(lambda link: link.write(group, values), patience_s)
                return
            except RefusedError as refused:
                self._explain(refused, group, patience_s)
                if attempt == REFUSALS_BELIEVED - 1:
                    raise _as_error(refused) from refused
                time.sleep(0.005 * 4**attempt)

    def _explain(self, refused: RefusedError, group: str, patience_s: float | None) -> None:
        """Raise what the device's status says about a refusal, if it says anything."""
        values = self.status(patience_s=patience_s)
        trip = coded(TripCause, values["trip"], "status.trip")
        if refused.refusal is Refusal.TRIPPED and trip != TripCause.NONE:
            raise LatchedTripError(
                trip.name.lower(), f"a trip is latched ({self.trip_message(trip)}); acknowledge it first"
            ) from refused
        mine = (self.token != 0 or group == "release") and self.holds(values)
        if refused.refusal is Refusal.LEASE and not mine and (self.token or values.get("lease_holder")):
            raise held_by(values) from refused

    def holds(self, status: Values) -> bool:
        """Whether the status names this host as the lease's holder; a map without that object is taken at its word."""
        mine = encode(BY_NAME["lease"]["holder"], self.holder).rstrip(b"\0").decode("utf-8")
        return status.get("lease_holder", mine) == mine

    def trip_message(self, trip: TripCause) -> str:
        """Why the trip latched, in words."""
        return str(self.read("trip").get("message", "")) or f"the controller tripped: {trip.name.lower()}"

    def stop(self, token: int) -> None:
        """Say stop on the urgent connection until it is heard, past any transfer that is under way.

        Raises
        ------
        BusError
            It was not heard within a second.
        StopRefusedError
            The device refused it for as long: it may go on exciting.
        """
        deadline = time.monotonic() + STOP_PATIENCE_S
        while True:
            try:
                with self._urgent_lock:
                    self._urgent.write("stop", {"token": token})
                return
            except RefusedError as refused:
                if time.monotonic() > deadline:
                    raise StopRefusedError(
                        f"{self.links.description}: the controller refused to stop: {refused}; end the excitation there"
                    ) from refused
            except BusError as error:
                if time.monotonic() > deadline:
                    raise BusError(
                        f"{self.links.description}: {error}; without heartbeat the controller stops by itself"
                    ) from error
            time.sleep(0.01)


def readable(read: Callable[[], T]) -> T:
    """What a link reads. A device of ours never refuses what may be read: then the bus is at fault."""
    try:
        return read()
    except RefusedError as refused:
        raise BusError(f"reading was refused: {refused}") from refused


def held_by(status: Values) -> LeaseError:
    """The error of a rig that someone else holds, or nobody."""
    return LeaseError(str(status.get("lease_holder", "")), number(status.get("lease_seconds_left", 0.0)))


def _as_error(refused: RefusedError) -> ControllerError:
    if refused.refusal is Refusal.LIMIT:
        return LimitError(f"the controller refused a value: {refused}")
    return ControllerError(f"the controller refused: {refused}")
