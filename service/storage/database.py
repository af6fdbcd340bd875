"""Connection to our own tables: SQLite in write-ahead mode, or PostgreSQL."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine, create_engine, event, make_url, text
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, SQLAlchemyError
from sqlalchemy.orm import Session, sessionmaker

from service.errors import StorageError
from service.private import private_file, private_folder
from service.storage.changes import Changes
from service.storage.pooling import pool_options
from sim.errors import reason

T = TypeVar("T")

_POSTGRESQL = {
    "connect_timeout": 5,
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
    "application_name": "ambit",
}
"""A server that vanished is noticed within seconds: a job that is cancelled meanwhile must hear of it."""
_LOCKED_S = 30.0
"""Longest wait for another process that writes an SQLite file."""
_PAUSE_S = 0.2
_LONGEST_PAUSE_S = 5.0


def now() -> datetime:
    """The time, UTC."""
    return datetime.now(UTC)


def use_wal(path: Path) -> None:
    """Turn an SQLite file, made where there is none, to write-ahead mode: readers do not wait for a writer.

    Raises
    ------
    StorageError
        The file cannot be made or written.
    """
    import sqlite3

    def turn() -> None:
        connection = sqlite3.connect(path, timeout=_LOCKED_S)
        try:
            connection.execute("PRAGMA journal_mode=WAL")
        finally:
            connection.close()

    try:
        private_folder(path.parent)
        os.close(private_file(path, os.O_RDWR | os.O_CREAT))  # SQLite gives the files beside it the same mode
        patient_until = time.monotonic() + _LOCKED_S
        while True:
            try:
                return turn()
            except sqlite3.OperationalError as error:
                # of several that turn a new file at once, SQLite refuses all but one without waiting
                if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > patient_until:
                    raise
            time.sleep(0.01)
    except (OSError, sqlite3.Error) as error:
        raise StorageError(
            f"cannot use the database {path}: {reason(error)}; choose another folder with AMBIT_HOME"
        ) from error


def sqlite_file(url: str) -> Path | None:
    """File of an SQLite URL; None for another database or one in memory."""
    parts = make_url(url)
    return Path(parts.database) if parts.get_backend_name() == "sqlite" and parts.database else None


class Database:
    """Our own tables.

    Parameters
    ----------
    url
        ``sqlite:////folder/file.db`` or ``postgresql://user:password@host/name``.

    Raises
    ------
    StorageError
        The SQLite file cannot be made.
    """

    def __init__(self, url: str, pool_size: int = 10) -> None:
        self.is_sqlite = url.startswith("sqlite")
        self._changes: Changes | None = None
        if (path := sqlite_file(url)) is not None:
            use_wal(path)
            self._changes = Changes(path)
        if url.startswith("postgresql:"):
            url = "postgresql+psycopg:" + url.removeprefix("postgresql:")
        of_sqlite = {"timeout": _LOCKED_S, "check_same_thread": False}
        arguments: dict[str, Any] = of_sqlite if self.is_sqlite else _POSTGRESQL
        self.engine: Engine = create_engine(
            url,
            pool_size=pool_size,
            max_overflow=2 * pool_size,
            connect_args=arguments,
            **({} if self.is_sqlite else pool_options()),
        )
        self._writing = self.engine
        reading = self.engine
        if self.is_sqlite:
            event.listen(self.engine, "connect", _prepare)
            event.listen(self.engine, "begin", _begin)
            self._writing = self.engine.execution_options(immediate=True)
        else:  # every statement sees its own moment anyway; a transaction around it is two more questions
            reading = self.engine.execution_options(isolation_level="AUTOCOMMIT")
        self._read = sessionmaker(reading, expire_on_commit=False)
        self._write = sessionmaker(self._writing, expire_on_commit=False)
        # SQLite has one writer: those of this process queue here, in order, and not in its busy handler
        self._turn = threading.Lock() if self.is_sqlite else None

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A session for reading."""
        with self._read() as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """A session in one transaction: committed at the end, rolled back when an error leaves it."""
        if self._turn is None:
            with self._write.begin() as session:
                yield session
            return
        with self._turn, self._write.begin() as session:
            yield session

    def surely(self, change: Callable[[Session], T], given_up: Callable[[], bool] = lambda: False) -> T:
        """Result of a change in one transaction, tried again for as long as the database is away.

        Parameters
        ----------
        change
            May run more than once.
        given_up
            Asked before every further try; True raises the error.

        Raises
        ------
        SQLAlchemyError
            Of ``change``, when it is no lost connection, or when given up.
        """
        pause = _PAUSE_S
        while True:
            try:
                with self.write() as session:
                    return change(session)
            except SQLAlchemyError as error:
                if not connection_lost(error) or given_up():
                    raise
                time.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE_S)

    def mark(self) -> int | None:
        """A number that differs once anyone has committed anything; None where that cannot be told: PostgreSQL.

        What was read after a mark was taken still holds while the mark is the same.
        """
        return None if self._changes is None else self._changes.mark()

    def check(self) -> None:
        """Raise SQLAlchemyError when the database does not answer."""
        with self.engine.connect() as connection:
            connection.execute(text("SELECT 1"))

    def close(self) -> None:
        """Give up every connection."""
        self.engine.dispose()
        if self._changes is not None:
            self._changes.close()


def connection_lost(error: SQLAlchemyError) -> bool:
    """Whether trying again may help: the connection was lost or refused, or SQLite is locked."""
    if isinstance(error, DBAPIError) and error.connection_invalidated:
        return True
    return isinstance(error, OperationalError | InterfaceError)


def _prepare(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # the driver shall not begin transactions by itself
    cursor = connection.cursor()
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.execute("PRAGMA synchronous=NORMAL")
    cursor.execute("PRAGMA busy_timeout=30000")
    cursor.close()


def _begin(connection: Connection) -> None:
    # a transaction that will write says so at once: one that turns from reading to writing may fail
    immediate = connection.get_execution_options().get("immediate", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if immediate else "BEGIN")
