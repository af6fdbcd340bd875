"""Turns on a line that carries one request at a time: the most urgent of those that wait is next."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from itertools import count


class Urgency(IntEnum):
    """Who goes first."""

    STOP = 0
    BEAT = 1
    """A heartbeat: the lease and the watchdog hang on it."""
    DATA = 2
    """Anything that may wait: a raw record keeps a slow line busy for minutes."""


class Turns:
    """A lock that is handed on, one request at a time: by urgency, and among equals to whoever came first.

    After a heartbeat whoever waits goes before the next one: where it takes longer than its period, as on a slow line,
    the next one is due at once, and nothing else would ever be said.

    A thread that gives its turn up and asks for the next one at once stands behind those that waited meanwhile, which
    `threading.RLock` does not promise. Whoever has the turn may take it again.
    """

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._changed = threading.Condition(self._mutex)
        self._numbers = count()
        self._waiting: list[tuple[Urgency, int]] = []
        self._last = Urgency.DATA
        self._holder: int | None = None
        self._depth = 0

    @contextmanager
    def turn(self, urgency: Urgency) -> Iterator[None]:
        """Hold the line for one request."""
        self._take(urgency)
        try:
            yield
        finally:
            self._give()

    def _take(self, urgency: Urgency) -> None:
        me = threading.get_ident()
        with self._mutex:
            if self._holder != me:
                ticket = (urgency, next(self._numbers))
                self._waiting.append(ticket)
                try:
                    while self._holder is not None or ticket != self._next():
                        self._changed.wait()
                    self._holder, self._last = me, urgency
                finally:  # an interrupted wait keeps nobody else from the line
                    self._waiting.remove(ticket)
                    self._changed.notify_all()
            self._depth += 1

    def _next(self) -> tuple[Urgency, int]:
        others = [ticket for ticket in self._waiting if ticket[0] is not self._last]
        return min((self._last is Urgency.BEAT and others) or self._waiting)

    def _give(self) -> None:
        with self._mutex:
            self._depth -= 1
            if self._depth == 0:
                self._holder = None
                self._changed.notify_all()
