"""What was read for an answer, kept for the next one while the database is the same."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

from anyio import CapacityLimiter, to_thread

from service.aside import aside, within
from service.storage.database import Database

T = TypeVar("T")


class Momentary(Generic[T]):
    """What costs something to find out and may be a moment old; whoever asks meanwhile waits for the same answer.

    One thread of its own finds it out, so that what does not answer takes none from the requests.

    Parameters
    ----------
    seconds
        How old the answer may be.
    patience_s
        How long it may take to be found out.
    """

    def __init__(self, seconds: float, patience_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds = seconds
        self._patience_s = patience_s
        self._clock = clock
        self._began = 0.0
        self._answer: Future[T] | None = None
        self._lock = threading.Lock()

    async def get(self, read: Callable[[], T]) -> T:
        """The answer, at most so many seconds old.

        Raises
        ------
        TimeoutError
            There is none within the patience. One older than that is no answer: it may be what has changed.
        """
        with self._lock:
            at = self._clock()
            answer = self._answer
            if answer is None or (answer.done() and at - self._began >= self._seconds):
                answer = self._answer = aside(read, "moment")
                self._began = at
            left = self._began + self._patience_s - at
        return await within(left, answer)  # those who come later wait no longer than who asked first

    def forget(self) -> None:
        """Let nobody have the answer any more, as what it tells has been changed; one under way is waited for."""
        with self._lock:
            if self._answer is not None and self._answer.done():
                self._answer = None


class Kept(Generic[T]):
    """The things asked for last.

    Parameters
    ----------
    database
        Tells whether anything has changed; one that cannot tell is read every time.
    largest
        How many things.
    threads
        Those that read; without it, those of the requests.
    """

    def __init__(self, database: Database, largest: int = 256, threads: CapacityLimiter | None = None) -> None:
        self._database = database
        self._largest = largest
        self._threads = threads
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
        thing = await to_thread.run_sync(read, limiter=self._threads)
        if mark is not None:
            with self._lock:
                self._things[name] = (mark, thing)
                self._things.move_to_end(name)
                while len(self._things) > self._largest:
                    self._things.popitem(last=False)
        return thing
