"""Calls that may hang, each in a daemon thread of its own: whoever waits may leave, and no process waits to end."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def aside(call: Callable[[], T], name: str) -> Future[T]:
    """What a call comes to, in a thread of this name. A pool's threads would be waited for at the end of Python."""
    found: Future[T] = Future()

    def run() -> None:
        try:
            found.set_result(call())
        except Exception as error:
            found.set_exception(error)

    threading.Thread(target=run, name=name, daemon=True).start()
    return found


async def within(seconds: float, found: Future[T]) -> T:
    """What the call comes to, if it does so in time; it goes on in any case, for others who wait for it.

    Raises
    ------
    TimeoutError
        It does not.
    """
    waited = asyncio.wrap_future(found)
    waited.add_done_callback(
        lambda late: late.cancelled() or late.exception()
    )  # heard, though nobody may wait any more
    return await asyncio.wait_for(asyncio.shield(waited), max(seconds, 0.0))
