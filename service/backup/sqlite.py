"""SQLite: copies while the service runs, by SQLite's own online backup, and proof that the copy is whole."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from service.errors import StorageError

PAGES = 1000
"""Copied at a time; writers get their turn in between."""
BUSY_S = 30.0


def copy(source: Path, target: Path) -> None:
    """Copy a database, which may be in use on either side, over another one.

    Raises
    ------
    StorageError
        It cannot be read or written, or is damaged.
    """
    try:
        with (
            closing(sqlite3.connect(f"file:{source.absolute()}?mode=ro", uri=True, timeout=BUSY_S)) as old,
            closing(sqlite3.connect(target, timeout=BUSY_S)) as new,
        ):
            new.execute("PRAGMA busy_timeout=30000")
            old.backup(new, pages=PAGES, sleep=0.01)
            check(new, target)
    except sqlite3.Error as error:
        raise StorageError(f"cannot copy the database {source} to {target}: {error}; stop what uses it") from error


def check(connection: sqlite3.Connection, path: Path) -> None:
    """Refuse a database that SQLite finds damaged."""
    found = connection.execute("PRAGMA integrity_check").fetchone()[0]
    if found != "ok":
        raise StorageError(f"the database {path} is damaged ({str(found).splitlines()[0]}); restore a backup")


def as_one_file(path: Path) -> None:
    """Leave a copy in the journal mode that needs no other file beside it."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA journal_mode=DELETE")
