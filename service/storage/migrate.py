"""Brings the tables to the form that this version of the product knows."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, text
from sqlalchemy.exc import OperationalError

from service.errors import StorageError
from service.storage.database import Database

_LOCK = 3_116_221_119
"""PostgreSQL's advisory lock under which one process migrates while the others wait."""


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")))
    config.attributes["connection"] = connection
    return config


def head() -> str:
    """Newest revision that this version knows."""
    return ScriptDirectory.from_config(_config()).get_current_head() or ""


def revision(database: Database) -> str:
    """Revision of the tables; empty where there are none."""
    with database.engine.connect() as connection:
        return MigrationContext.configure(connection).get_current_revision() or ""


def upgrade(database: Database, to: str = "head") -> str:
    """Upgrade the tables; the revision that they then have. Several processes may call it at once.

    Raises
    ------
    StorageError
        The tables are of a newer version of the product, or the database does not answer.
    """
    try:
        return _upgraded(database, to)
    except OperationalError as error:
        reason = " ".join(str(error.orig).split())
        raise StorageError(f"the database does not answer: {reason}; start it, or correct database_url") from error


def _upgraded(database: Database, to: str) -> str:
    known = {script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions()}
    with database.engine.connect() as connection:
        immediate = connection.execution_options(immediate=True)
        with immediate.begin():
            if not database.is_sqlite:
                immediate.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            found = MigrationContext.configure(immediate).get_current_revision()
            if found is not None and found not in known:
                raise StorageError(
                    f"the database has revision {found}, which this version of the product does not know; "
                    "install the newer version, or restore the backup that was made before the upgrade"
                )
            command.upgrade(_config(immediate), to)
    return revision(database)
