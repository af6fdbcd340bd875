"""Ctrl-C and SIGTERM: where a rig is excited, the first asks the job to stop in good order, the second insists."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from service.remarks import say


@contextmanager
def asked_to_stop(notice: str) -> Iterator[Callable[[], bool]]:
    """Whether the user has asked to stop, as a function; ``notice`` is said at once.

    A second signal raises KeyboardInterrupt. Must be entered in the main thread.
    """
    asked = threading.Event()

    def ask(signum: int, frame: FrameType | None) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()
        say(notice)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def kill_is_ctrl_c() -> Iterator[None]:
    """SIGTERM raises KeyboardInterrupt, too: what a command started ends with it, and it says what is kept.

    Must be entered in the main thread.
    """
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
