"""Our own tables, migrated, on SQLite and on PostgreSQL."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from service.storage.database import Database
from service.storage.migrate import upgrade

BOTH = ["sqlite", pytest.param("postgresql", marks=pytest.mark.pg)]


@contextmanager
def migrated(kind: str, folder: Path) -> Iterator[Database]:
    """A database with empty tables."""
    with ExitStack() as stack:
        if kind == "postgresql":
            from tests.support.postgres import empty_database

            url = stack.enter_context(empty_database())
        else:
            url = f"sqlite:///{folder / 'ambit.db'}"
        database = Database(url)
        stack.callback(database.close)
        upgrade(database)
        yield database
