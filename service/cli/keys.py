"""``ambit keys``: who may use the service. Works on the service's database itself: the first key needs no key."""

from __future__ import annotations

from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.access.keys import Scope
from service.cli.console import Json, print_json, stdout
from service.cli.installation import Config, Home
from service.remarks import one_line, say, shown

if TYPE_CHECKING:
    from collections.abc import Iterator

    from service.storage.database import Database
    from service.storage.tables import KeyRow

LONGEST_NAME = 200
app = typer.Typer(no_args_is_help=True, help="API keys of the service: create, list, revoke.")


@app.command()
def create(
    name: Annotated[str, typer.Option(help="Who or what holds it; the audit log shows this.")] = "",
    scope: Annotated[
        Scope | None,
        typer.Option(help="What it may do; the first key is admin, later ones viewer.", show_default=False),
    ] = None,
    days: Annotated[
        float | None, typer.Option(help="Days until it expires; never without it.", min=0.001, max=36_500)
    ] = None,
    config: Config = None,
    home: Home = None,
    as_json: Json = False,
) -> None:
    """Make a key, and print it once: it is kept nowhere, only its hash is."""
    from service.access import keys
    from service.access.audit import Action, audited
    from service.storage import audit
    from service.storage import keys as rows
    from service.storage.database import now
    from service.storage.ids import new_id

    _must_be_shown(name)
    with _database(config, home) as database, database.write() as session:
        first = not rows.any_key(session)
        scope = scope or (Scope.admin if first else Scope.viewer)
        at = now()
        expires = None if days is None else at + timedelta(days=days)
        record, key = keys.issue(new_id("key"), name or f"{scope} key", scope, at, expires)
        rows.add(session, rows.row(record, created_by=keys.LOCAL.name))
        audit.record(session, audited(keys.LOCAL, Action.key_created, record.id, name=record.name, scope=str(scope)))
    if as_json:
        print_json({"id": record.id, "name": record.name, "scope": str(scope), "expires": _time(expires), "key": key})
        return
    print(key)
    until = "" if expires is None else f" until {_time(expires)}"
    say(f"{record.id}: {scope}{until}. The key is shown only now; use it as AMBIT_KEY, or as Authorization: Bearer")
    if first:
        say("from now on the service asks everyone for a key, and may listen to the network after its next start")


@app.command("list")
def list_keys(config: Config = None, home: Home = None, as_json: Json = False) -> None:
    """List the keys, newest first; never the keys themselves."""
    from service.storage import keys as rows

    with _database(config, home) as database, database.read() as session:
        found = [_document(row) for row in rows.listed(session)]
    if as_json:
        print_json({"keys": found})
        return
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("id", "name", "scope", "state", "created", "expires", "last used", "from"):
        table.add_column(head)
    for d in found:
        times = (d[k] or "" for k in ("created", "expires", "used"))
        cells = (d["id"], one_line(shown(d["name"])), d["scope"], d["state"], *times, d["used_from"])
        table.add_row(*map(Text, cells))  # names are no markup
    stdout().print(table)


@app.command()
def revoke(
    key_id: Annotated[str, typer.Argument(metavar="ID", help="Id of the key, key_...")],
    config: Config = None,
    home: Home = None,
    as_json: Json = False,
) -> None:
    """Revoke a key: the next request with it is refused."""
    from service.access import keys
    from service.access.audit import Action, audited
    from service.storage import audit
    from service.storage import keys as rows

    with _database(config, home) as database, database.write() as session:
        row = rows.revoke(session, key_id)
        audit.record(session, audited(keys.LOCAL, Action.key_revoked, key_id, name=row.name))
        revoked = _document(row)
    if as_json:
        print_json(revoked)
        return
    say(f"{key_id} ({shown(revoked['name'])}) is revoked")


def _must_be_shown(name: str) -> None:
    """Refuse a name that a terminal would obey, or that would not be kept whole."""
    if len(name) > LONGEST_NAME or not name.isprintable():
        raise typer.BadParameter(
            f"the name of a key has at most {LONGEST_NAME} characters, none of which is a control character",
            param_hint="--name",
        )


def _document(row: KeyRow) -> dict[str, Any]:
    from service.storage import keys as rows
    from service.storage.database import now

    return {
        "id": row.id,
        "name": row.name,
        "scope": row.scope,
        "state": rows.record(row).state(now()),
        "created": _time(row.created_at),
        "expires": _time(row.expires_at),
        "used": _time(row.used_at),
        "used_from": row.used_from,
        "revoked": _time(row.revoked_at),
    }


def _time(at: Any) -> str | None:
    return None if at is None else f"{at:%Y-%m-%dT%H:%M:%SZ}"


@contextmanager
def _database(config: Path | None, home: Path | None) -> Iterator[Database]:
    """The service's own database, brought to this version."""
    from sqlalchemy.exc import SQLAlchemyError

    from service.config import load
    from service.errors import StorageError
    from service.storage import migrate
    from service.storage.database import Database

    database = Database(load(config, flags={"home": home}).database)
    try:
        migrate.upgrade(database)
        yield database
    except SQLAlchemyError as error:
        reason = str(getattr(error, "orig", None) or error)
        raise StorageError(f"cannot use the database: {reason}; check AMBIT_DATABASE_URL") from error
    finally:
        database.close()
