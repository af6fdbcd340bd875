"""The seam between what a controller means and how a bus carries it: every bus is one `Link`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drivers.amplitude import Amplitudes
from drivers.errors import ControllerError
from drivers.objects import Refusal
from drivers.packing import Order, Value, Values


def go_on() -> None:
    """Nothing speaks against it."""


class RefusedError(ControllerError):
    """The device answered, and refused a write or a read."""

    def __init__(self, refusal: Refusal, message: str) -> None:
        super().__init__(message)
        self.refusal = refusal


class Link(Protocol):
    """One connection to a device. Not safe from two threads at once; every method may raise `BusError`.

    After a `BusError` the link has cleared itself, and the next call connects anew.
    """

    order: Order
    """Byte order of payloads."""

    def read(self, group: str) -> dict[str, Value]:
        """Snapshot of a group, its CRC checked; objects that the device's map lacks are missing."""

    def write(self, group: str, values: Values) -> None:
        """Carry out a command; raises `RefusedError` when the device refuses it."""

    def lockin_payload(self, size: int) -> bytes:
        """Lock-in payload of the last result, not checked."""

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        """Raw record of a result, not checked.

        ``between`` is called between its parts: on a slow line it takes minutes, and what this raises ends them.
        """

    def wait_for_change(self, seconds: float) -> int | None:
        """Wait until the device says that something happened, or the time is over.

        Returns
        -------
        The number of a command that the device says was carried out; None where it said nothing, or that it failed.
        A hint: the result's header is the proof.
        """

    def close(self) -> None:
        """Give up the connection; safe twice."""


class LinkFactory(Protocol):
    """Makes connections to one device: one for the measurement, one for heartbeat and stop."""

    description: str
    """For messages: scheme, host, unit."""
    raw_bytes_per_s: float | None
    """About how fast a raw record comes, on a line that is slow by nature; None on others."""
    silence_s: float
    """Between two heartbeats while a tone plays, on a line that they share with all else; 0 on others."""
    amplitudes: Amplitudes
    """Which amplitudes of a tone the map carries."""

    def link(self, urgent: bool = False) -> Link:
        """Connection that opens itself at the first call; `urgent` has short time-outs."""

    def close(self) -> None:
        """Give up what the links share."""
