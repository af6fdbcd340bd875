"""Who may excite: one lease at a time, with a token, a time to live and, on a bus, a heartbeat."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import LeaseError

NO_TOKEN = 0
WATCHDOG_S = 0.2
"""Silence of the host after which a controller ends the excitation, unless it is told otherwise."""


def drawn_token() -> int:
    """A token for a lease."""
    return secrets.randbelow(2**32 - 1) + 1


@dataclass
class Lease:
    """A lease that is held. Times are of the table's clock."""

    token: int
    holder: str
    seconds: float
    deadline: float
    attached: bool
    """Held by a context in the device's own process, which cannot vanish without the device: never lapses."""
    last_beat: float
    beat_count: int = 0


class LeaseTable:
    """The rig's one lease. All methods are safe from any thread.

    Parameters
    ----------
    clock
        Seconds that never go back.
    watchdog_s
        Silence after which a lease that is not attached counts as lost, s.
    """

    def __init__(self, clock: Callable[[], float], watchdog_s: float) -> None:
        self._clock = clock
        self.watchdog_s = watchdog_s
        self._lock = threading.Lock()
        self._lease: Lease | None = None

    def _current(self) -> Lease | None:
        lease = self._lease
        if lease is not None and not lease.attached and self._clock() >= lease.deadline:
            self._lease = lease = None
        return lease

    def acquire(self, holder: str, seconds: float, attached: bool = False, token: int | None = None) -> int:
        """Token of a new lease; asking again with the ``token`` that already holds renews it.

        Raises
        ------
        LeaseError
            The lease is held; names the holder and the time left.
        """
        with self._lock:
            held = self._current()
            now = self._clock()
            if held is not None and held.token == token:
                held.last_beat, held.deadline = now, now + held.seconds
                return held.token
            if held is not None:
                raise LeaseError(held.holder, held.seconds if held.attached else held.deadline - now)
            token = token or drawn_token()
            self._lease = Lease(token, holder, seconds, now + seconds, attached, now)
            return token

    def require(self, token: int) -> Lease:
        """Lease of this token; raises `LeaseError` when it is not the one that holds the rig."""
        with self._lock:
            held = self._current()
            if held is None or token == NO_TOKEN or held.token != token:
                raise LeaseError("" if held is None else held.holder, self._left(held))
            return held

    def holds(self, token: int) -> bool:
        """Whether this token holds the rig now."""
        with self._lock:
            held = self._current()
            return held is not None and held.token == token != NO_TOKEN

    def beat(self, token: int, count: int) -> bool:
        """Feed the watchdog and renew the lease; False when the token does not hold, or the counter stands still."""
        with self._lock:
            held = self._current()
            if held is None or held.token != token or count == held.beat_count:
                return False
            held.beat_count = count
            held.last_beat = self._clock()
            held.deadline = held.last_beat + held.seconds
            return True

    def feed(self, token: int) -> None:
        """Count a command of the holder as a sign of life, for the watchdog only."""
        with self._lock:
            held = self._current()
            if held is not None and held.token == token:
                held.last_beat = self._clock()

    def silent(self) -> bool:
        """Whether the holder has been silent for longer than the watchdog allows."""
        return self.silence_s() > self.watchdog_s

    def silence_s(self) -> float:
        """Time since the holder's last sign of life, s; 0 for an attached lease, infinite for none."""
        with self._lock:
            held = self._current()
            if held is None:
                return float("inf")
            return 0.0 if held.attached else self._clock() - held.last_beat

    def release(self, token: int) -> bool:
        """Give the lease back; False, and nothing happens, when this token does not hold it."""
        with self._lock:
            held = self._current()
            if held is None or held.token != token:
                return False
            self._lease = None
            return True

    def holder(self) -> tuple[str, float]:
        """Holder, empty when free, and the time left, s."""
        with self._lock:
            held = self._current()
            return ("", 0.0) if held is None else (held.holder, self._left(held))

    def _left(self, held: Lease | None) -> float:
        if held is None:
            return 0.0
        return held.seconds if held.attached else max(held.deadline - self._clock(), 0.0)
