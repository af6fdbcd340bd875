"""PostgreSQL: a logical copy, table by table, out of one consistent snapshot; no program of the server's is needed.

The form is COPY's own text, so values come back bit for bit, into any version of the server.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.errors import StorageError

if TYPE_CHECKING:
    from psycopg import Connection
    from psycopg.sql import Composed

CHUNK = 1 << 20


@contextmanager
def snapshot(url: str) -> Iterator[Connection[Any]]:
    """A connection in one read-only transaction: it sees the database as it was at one moment.

    Raises
    ------
    StorageError
        The server does not answer, or refuses.
    """
    with _connected(url) as connection:
        connection.execute("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY")
        yield connection


@contextmanager
def change(url: str) -> Iterator[Connection[Any]]:
    """A connection in one transaction, all of it or nothing."""
    with _connected(url) as connection:
        yield connection


@contextmanager
def _connected(url: str) -> Iterator[Connection[Any]]:
    try:
        import psycopg
    except ImportError as error:
        raise StorageError("PostgreSQL needs psycopg; pip install 'amb-commissioning[postgres]'") from error
    try:
        with psycopg.connect(url, connect_timeout=10) as connection:
            yield connection
    except psycopg.Error as error:
        reason = " ".join(str(error).split())
        raise StorageError(f"the PostgreSQL database cannot be used ({reason}); check its URL") from error


def tables(connection: Connection[Any], schema: str) -> list[str]:
    """Tables of a schema."""
    found = connection.execute(
        "SELECT tablename FROM pg_tables WHERE schemaname = %s ORDER BY tablename", (schema,)
    ).fetchall()
    return [row[0] for row in found]


def columns(connection: Connection[Any], schema: str, table: str) -> list[str]:
    """Columns of a table that hold data, in order."""
    found = connection.execute(
        "SELECT column_name FROM information_schema.columns "
        "WHERE table_schema = %s AND table_name = %s AND is_generated = 'NEVER' ORDER BY ordinal_position",
        (schema, table),
    ).fetchall()
    return [row[0] for row in found]


def dump(connection: Connection[Any], schema: str, names: Iterable[str], folder: Path) -> dict[str, list[str]]:
    """Write tables into a folder, one file each; their columns by table."""
    folder.mkdir(parents=True, exist_ok=True)
    written = {}
    for table in names:
        written[table] = columns(connection, schema, table)
        statement = _copy("COPY {} ({}) TO STDOUT", schema, table, written[table])
        with (folder / f"{table}.copy").open("wb") as out, connection.cursor().copy(statement) as rows:
            for part in rows:
                out.write(part)
    return written


def load(connection: Connection[Any], schema: str, written: dict[str, list[str]], folder: Path) -> None:
    """Put tables back in place of what is there; foreign keys are looked at again at the end."""
    if not written:
        return
    from psycopg import sql

    known = set(tables(connection, schema))
    if lost := sorted(set(written) - known):
        raise StorageError(
            f"the database has no table {lost[0]!r}, the backup has; restore with the version that made it"
        )
    every = sql.SQL(", ").join(sql.Identifier(schema, table) for table in written)
    connection.execute(sql.SQL("TRUNCATE {} CASCADE").format(every))
    for table in _parents_first(connection, schema, list(written)):
        statement = _copy("COPY {} ({}) FROM STDIN", schema, table, written[table])
        with (folder / f"{table}.copy").open("rb") as source, connection.cursor().copy(statement) as rows:
            while part := source.read(CHUNK):
                rows.write(part)
    _go_on_counting(connection, schema)


def _copy(text: str, schema: str, table: str, names: list[str]) -> Composed:
    from psycopg import sql

    columns_of = sql.SQL(", ").join(map(sql.Identifier, names))
    return sql.SQL(text).format(sql.Identifier(schema, table), columns_of)


def _parents_first(connection: Connection[Any], schema: str, names: list[str]) -> list[str]:
    """The tables in an order in which every foreign key finds its row."""
    found = connection.execute(
        "SELECT c.relname, p.relname FROM pg_constraint k "
        "JOIN pg_class c ON c.oid = k.conrelid JOIN pg_class p ON p.oid = k.confrelid "
        "JOIN pg_namespace n ON n.oid = c.relnamespace WHERE k.contype = 'f' AND n.nspname = %s AND c.oid <> p.oid",
        (schema,),
    ).fetchall()
    needs: dict[str, set[str]] = {name: set() for name in names}
    for child, parent in found:
        if child in needs and parent in needs:
            needs[child].add(parent)
    order: list[str] = []
    while len(order) < len(names):
        ready = [name for name in names if name not in order and needs[name] <= set(order)]
        if not ready:  # a circle: the server will say so
            ready = [name for name in names if name not in order]
        order += ready
    return order


def _go_on_counting(connection: Connection[Any], schema: str) -> None:
    """Set every sequence behind the greatest number that is in use."""
    from psycopg import sql

    owned = connection.execute(
        "SELECT s.relname, t.relname, a.attname FROM pg_class s JOIN pg_depend d ON d.objid = s.oid "
        "AND d.deptype IN ('a', 'i') AND d.classid = 'pg_class'::regclass AND d.refclassid = 'pg_class'::regclass "
        "JOIN pg_class t ON t.oid = d.refobjid "
        "JOIN pg_attribute a ON a.attrelid = t.oid AND a.attnum = d.refobjsubid "
        "JOIN pg_namespace n ON n.oid = s.relnamespace WHERE s.relkind = 'S' AND n.nspname = %s",
        (schema,),
    ).fetchall()
    for sequence, table, column in owned:
        connection.execute(
            sql.SQL("SELECT setval({}, COALESCE((SELECT MAX({}) FROM {}), 0) + 1, false)").format(
                sql.Literal(f'"{schema}"."{sequence}"'), sql.Identifier(column), sql.Identifier(schema, table)
            )
        )
