"""A folder for one process at a time; the lock ends with the process, however that ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.errors import ConflictError

LOCK = ".in-use"


@contextmanager
def sole_use(folder: Path, who: str, remedy: str) -> Iterator[None]:
    """Keep every other process that asks out of a folder, which exists.

    Raises
    ------
    ConflictError
        Another process has it; the message names ``who`` and ends with the ``remedy``.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows: there the worker's name keeps a second one out, later and in other words
        yield
        return
    with (folder / LOCK).open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConflictError(f"{who} is at work in {folder}; {remedy}") from None
        yield
