"""A folder for one process at a time; the lock ends with the process, however that ends."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from service.errors import InUseError

LOCK = ".in-use"
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP)
"""What a file system without locks answers."""


@contextmanager
def sole_use(folder: Path, who: str, remedy: str, name: str = LOCK) -> Iterator[None]:
    """Keep every other process that asks by the same ``name`` out of a folder, which exists.

    The lock is a file of that name, which is removed again; one that a killed process left keeps nobody out.

    Raises
    ------
    InUseError
        Another process has it; the message names ``who`` and ends with the ``remedy``.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows: there the worker's name keeps a second one out, later and in other words
        yield
        return
    path = folder / name
    while True:
        with path.open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InUseError(f"{who} is at work in {folder}; {remedy}") from None
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
            if not _still(lock, path):
                continue
            try:
                yield
            finally:
                with suppress(OSError):  # while it is locked: who has opened it by now sees that it is gone
                    path.unlink()
            return


def _still(lock: TextIO, path: Path) -> bool:
    """Whether an open file is the one at the path: whoever had it before may have removed it meanwhile."""
    try:
        return os.path.samestat(os.fstat(lock.fileno()), path.stat())
    except FileNotFoundError:
        return False
