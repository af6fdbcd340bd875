"""Whether an SQLite database has changed, for a few microseconds: cheaper than to read again what was read before."""

from __future__ import annotations

import sqlite3
import threading
from pathlib import Path


class Changes:
    """A connection that only ever asks for the database's version; safe among threads.

    Parameters
    ----------
    path
        The database's file, which exists.
    """

    def __init__(self, path: Path) -> None:
        # a timeout of 0: whoever asks this does not want to wait
        self._connection = sqlite3.connect(path, timeout=0, isolation_level=None, check_same_thread=False)
        self._lock = threading.Lock()

    def mark(self) -> int | None:
        """A number that differs once anyone has committed anything; None when it cannot be told now."""
        with self._lock:
            try:
                (version,) = self._connection.execute("PRAGMA data_version").fetchone()
            except sqlite3.Error:
                return None
        return int(version)

    def close(self) -> None:
        """Give up the connection."""
        with self._lock:
            self._connection.close()
