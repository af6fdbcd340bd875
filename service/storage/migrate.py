"""Brings the tables to the form that this version of the product knows.

alembic is loaded only where there is something to do: most processes find the tables as they know them, and it takes a
fifth of the time in which they start.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Connection, inspect, text
from sqlalchemy.exc import OperationalError

from service.errors import StorageError
from service.storage.database import Database

if TYPE_CHECKING:
    from alembic.config import Config

_MIGRATIONS = Path(__file__).with_name("migrations")
_LOCK = 3_116_221_119
"""PostgreSQL's advisory lock under which one process migrates while the others wait."""


def _config(connection: Connection | None = None) -> Config:
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS))
    config.attributes["connection"] = connection
    return config


def head() -> str:
    """Newest revision that this version knows."""
    return _known()[-1]


def _known() -> list[str]:
    """Revisions that this version knows, oldest first: each file's name begins with its own."""
    return sorted(path.name.partition("_")[0] for path in (_MIGRATIONS / "versions").glob("[0-9]*_*.py"))


def revision(database: Database) -> str:
    """Revision of the tables; empty where there are none."""
    with database.engine.connect() as connection:
        return _found(connection)


def _found(connection: Connection) -> str:
    if not inspect(connection).has_table("alembic_version"):
        return ""
    return str(connection.execute(text("SELECT version_num FROM alembic_version")).scalar() or "")


def known_revision(database: Database) -> str:
    """Revision of the tables, which stay as they are; empty where there are none.

    Raises
    ------
    StorageError
        The tables are of a newer version of the product, or the database does not answer.
    """
    with _answering():
        return _checked(revision(database))


def upgrade(database: Database, to: str = "head") -> str:
    """Upgrade the tables; the revision that they then have. Several processes may call it at once.

    Raises
    ------
    StorageError
        The tables are of a newer version of the product, or the database does not answer.
    """
    with _answering():
        return _upgraded(database, to)


@contextmanager
def _answering() -> Iterator[None]:
    try:
        yield
    except OperationalError as error:
        reason = " ".join(str(error.orig).split())
        raise StorageError(f"the database does not answer: {reason}; start it, or correct database_url") from error


def _checked(found: str) -> str:
    if found and found not in _known():
        raise StorageError(
            f"the database has revision {found}, which this version of the product does not know; "
            "install the newer version, or restore the backup that was made before the upgrade"
        )
    return found


def _upgraded(database: Database, to: str) -> str:
    if to in ("head", head()) and revision(database) == head():
        return head()
    from alembic import command

    with database.engine.connect() as connection:
        immediate = connection.execution_options(immediate=True)
        with immediate.begin():
            if not database.is_sqlite:
                immediate.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            _checked(_found(immediate))
            command.upgrade(_config(immediate), to)
    return revision(database)
