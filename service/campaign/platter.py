"""A file forced to the disk's platter from another thread, which no Ctrl-C can leave waiting.

Not by `concurrent.futures`: its locks are taken in Python code, and a KeyboardInterrupt in the middle of that leaves
one taken for ever, so that the pool's thread never ends, nor whoever waits for it. A `queue.SimpleQueue` is all C.
"""

from __future__ import annotations

import os
import threading
from queue import SimpleQueue


class Platter:
    """Forces one file, once at a time.

    Parameters
    ----------
    descriptor
        Of the open file, whose owner closes it, after `close`.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._asked = self._awaited = 0
        self._wanted: SimpleQueue[int | None] = SimpleQueue()
        self._forced: SimpleQueue[tuple[int, OSError | None]] = SimpleQueue()
        # a daemon: one whose start was interrupted does not keep the process from its end
        self._thread = threading.Thread(target=self._work, name="platter", daemon=True)
        self._thread.start()

    def force(self) -> None:
        """Begin to force what is written by now."""
        self._wanted.put(self._asked + 1)
        self._asked += 1  # last: nobody waits for what was not asked for

    def wait(self) -> None:
        """Wait until what was begun last is done.

        Raises
        ------
        OSError
            It could not be forced; this is told once.
        """
        if self._awaited == self._asked:
            return
        self._awaited, done = self._asked, 0  # first: the answer that an interrupted wait lost does not come again
        while done < self._asked:  # what such a wait did not fetch comes before it
            done, error = self._forced.get()
            if error is not None:
                raise error

    def close(self) -> None:
        """Finish what was begun, and end; safe twice."""
        self._wanted.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (number := self._wanted.get()) is not None:
            error: OSError | None = None
            try:
                os.fsync(self._descriptor)
            except OSError as problem:
                error = problem
            self._forced.put((number, error))
