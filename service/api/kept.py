"""What was read for an answer, kept for the next one while the database is the same."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from fastapi.concurrency import run_in_threadpool

from service.storage.database import Database

T = TypeVar("T")


class Momentary(Generic[T]):
    """What costs something to find out and may be a moment old; whoever asks meanwhile waits for the same answer."""

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds = seconds
        self._clock = clock
        self._found: tuple[float, T] | None = None
        self._lock = threading.Lock()

    def get(self, read: Callable[[], T]) -> T:
        """The answer, at most so many seconds old."""
        with self._lock:
            at = self._clock()
            if self._found is None or at - self._found[0] >= self._seconds:
                self._found = at, read()
            return self._found[1]


class Kept(Generic[T]):
    """The things asked for last.

    Parameters
    ----------
    database
        Tells whether anything has changed; one that cannot tell is read every time.
    largest
        How many things.
    """

    def __init__(self, database: Database, largest: int = 256) -> None:
        self._database = database
        self._largest = largest
        self._things: OrderedDict[str, tuple[int, T]] = OrderedDict()
        self._lock = threading.Lock()

    async def get(self, name: str, read: Callable[[], T]) -> T:
        """The thing of a name: at once when nothing has changed since, else as ``read`` finds it in a thread."""
        mark = self._database.mark()
        with self._lock:
            found = self._things.get(name)
            if found is not None and found[0] == mark:
                self._things.move_to_end(name)
                return found[1]
        thing = await run_in_threadpool(read)
        if mark is not None:
            with self._lock:
                self._things[name] = (mark, thing)
                self._things.move_to_end(name)
                while len(self._things) > self._largest:
                    self._things.popitem(last=False)
        return thing
