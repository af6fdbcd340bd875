"""Bring a service back from a backup, on this machine or another, into SQLite or PostgreSQL."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from sqlalchemy import create_engine, func, inspect, select, text, update

from service.access.audit import Action, audited
from service.access.keys import LOCAL
from service.backup import controllers, manifest, postgres, sqlite
from service.backup.create import COLUMNS, JOBS, JOBS_SCHEMA, OWN, OWN_SCHEMA, kind_of
from service.backup.manifest import Manifest
from service.config import Settings
from service.errors import ConflictError, NotFoundError, StorageError
from service.storage import audit, migrate, workers
from service.storage.blobs import Blobs
from service.storage.database import Database, now, sqlite_file
from service.storage.jobs import CANCELLED, QUEUED, RUNNING, cancelled_as
from service.storage.schedules import PENDING
from service.storage.tables import Base, JobRow, WebhookRow, WorkerRow
from sim.wording import in_words

UNFINISHED = (QUEUED, RUNNING)
ENGINE_UNFINISHED = ("PENDING", "ENQUEUED", "DELAYED")
WHY = "restored from a backup: no rotor moves because of a backup; try the job again"


def restore(
    settings: Settings,
    backup: Path,
    replace: bool = False,
    resume_jobs: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Manifest:
    """Put a backup's databases, controllers' files and store in place of what the settings name; upgrade the tables.

    Jobs that were queued or running when the backup was made are cancelled, unless ``resume_jobs``: nobody expects a
    rotor to move because a backup was restored. A backup from SQLite can be restored into PostgreSQL; the job engine
    then begins anew.

    Parameters
    ----------
    replace
        Give up what the target holds.

    Raises
    ------
    ConflictError
        The target holds something, or a worker runs on it.
    StorageError, DocumentError
        The backup is damaged or does not fit; nothing was changed.
    """
    held = manifest.read(backup)
    stored = _whole_store(backup, held)
    if held.database == "postgresql" and kind_of(settings.database) == "sqlite":
        raise StorageError("a backup from PostgreSQL is restored into PostgreSQL; set AMBIT_DATABASE_URL")
    database = Database(settings.database)
    try:
        _may_be_replaced(database, replace)
        if not replace:
            controllers.must_fit(backup, settings.home)
        say("the store")
        blobs = Blobs(settings.store)
        for path in stored:
            blobs.put_file(path, repair=True)
        _put_back_controllers(backup, settings)
        say("the databases")
        _own(database, settings.database, backup, held)
        migrate.upgrade(database)
        engine_kept = resume_jobs and held.jobs_database == kind_of(settings.jobs_database)
        _engine(settings.jobs_database, backup, held)
        _settle(database, settings.jobs_database, cancel=not engine_kept)
        with database.write() as session:
            audit.record(session, audited(LOCAL, Action.restored, backup.name, made=held.created))
    finally:
        database.close()
    return held


def upgrade(settings: Settings) -> tuple[str, str]:
    """Bring both databases to the form of this version; revision of our own tables before and after.

    Raises
    ------
    StorageError
        A database is of a newer version, or does not answer.
    """
    from dbos import DBOS

    database = Database(settings.database)
    try:
        before = migrate.revision(database)
        after = migrate.upgrade(database)
    finally:
        database.close()
    DBOS.migrate(settings.jobs_database)
    return before, after


def _whole_store(backup: Path, held: Manifest) -> list[Path]:
    """Files of the common store that a backup needs, each looked at before anything is changed."""
    store = backup.parent / manifest.STORE
    if manifest.NAMES not in held.files:
        raise StorageError(f"{backup} does not tell which files it needs; restore it with the version that made it")
    paths = [store / name[:2] / name for name in json.loads((backup / manifest.NAMES).read_text(encoding="utf-8"))]
    if lost := [path for path in paths if not path.is_file()]:
        raise StorageError(
            f"{len(lost)} of the {len(paths)} files that the backup needs are not in {store}, the first is "
            f"{lost[0].name}; copy the folder store together with the backup"
        )
    for path in paths:
        if manifest.digest(path) != path.name:
            raise StorageError(f"{path} is damaged; take another copy of the backup")
    return paths


def _put_back_controllers(backup: Path, settings: Settings) -> None:
    try:
        controllers.put_back(backup, settings.home)
    except OSError as error:
        why = error.strerror or error
        raise StorageError(
            f"cannot write into {settings.controllers}: {why}; free space, or let this user write there"
        ) from error


def _may_be_replaced(database: Database, replace: bool) -> None:
    if not inspect(database.engine).has_table(JobRow.__tablename__):
        return
    with database.read() as session:
        if alive := [w.name for w in workers.living(session)]:
            raise ConflictError(f"the worker {alive[0]!r} runs on this database; stop the service, then restore")
        passing = {"workers", "idempotency"}
        full = [
            table.name
            for table in Base.metadata.sorted_tables
            if table.name not in passing and session.scalar(select(func.count()).select_from(table))
        ]
    if full and not replace:
        raise ConflictError(f"the database holds {in_words(full[0])} already; --replace gives them up")


def _own(database: Database, url: str, backup: Path, held: Manifest) -> None:
    """Our own tables, in the form that they had in the backup."""
    if database.is_sqlite:
        target = sqlite_file(url)
        assert target is not None
        database.engine.dispose()
        sqlite.copy(backup / f"{OWN}.db", target)
        return
    with database.engine.begin() as connection:
        Base.metadata.drop_all(connection)
        connection.execute(text("DROP TABLE IF EXISTS alembic_version"))
    migrate.upgrade(database, held.revision)
    if held.database == "postgresql":
        with postgres.change(url) as connection:
            postgres.load(connection, OWN_SCHEMA, _columns(backup, OWN), backup / OWN)
        return
    migrate.upgrade(database)
    _from_sqlite(database, backup / f"{OWN}.db")


def _from_sqlite(database: Database, source: Path) -> None:
    """Rows of an SQLite backup into PostgreSQL, through a copy that has this version's tables."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / source.name
        sqlite.copy(source, copy)
        old = Database(f"sqlite:///{copy}")
        try:
            migrate.upgrade(old)
            with old.read() as reading, database.write() as writing:
                for table in Base.metadata.sorted_tables:
                    rows = reading.execute(select(table).execution_options(yield_per=1000)).mappings()
                    for part in rows.partitions(1000):
                        writing.execute(table.insert(), [dict(row) for row in part])
        finally:
            old.close()


def _engine(url: str, backup: Path, held: Manifest) -> None:
    """The job engine's tables; where the kind is another one, or there were none, it begins anew."""
    from dbos import DBOS

    same = held.jobs_database == kind_of(url)
    if kind_of(url) == "sqlite":
        target = sqlite_file(url)
        assert target is not None
        if same:
            sqlite.copy(backup / f"{JOBS}.db", target)
        else:
            for suffix in ("", "-wal", "-shm"):
                with suppress(FileNotFoundError):
                    Path(f"{target}{suffix}").unlink()
        return
    DBOS.migrate(url)
    with postgres.change(url) as connection:
        if same:
            written = _columns(backup, JOBS)
            written.pop("dbos_migrations", None)
            postgres.load(connection, JOBS_SCHEMA, written, backup / JOBS)


def _settle(database: Database, jobs_url: str, cancel: bool) -> None:
    """Nobody works any more, and what was unfinished has an end, or is handed to the engine again.

    The engine's copy is a little older than the rows: a job that was begun or submitted in between waits in no queue.
    What the engine knows it does not take twice. So with messages to webhooks: an attempt of which nobody will hear
    counts as made, and the next one is due.
    """
    at = now()
    with database.write() as session:
        session.execute(update(WorkerRow).where(WorkerRow.stopped_at.is_(None)).values(stopped_at=at))
        in_engine = update(WebhookRow).where(WebhookRow.state == PENDING, WebhookRow.dispatched)
        session.execute(in_engine.values(attempts=WebhookRow.attempts + 1, dispatched=False, next_at=at))
        unfinished = update(JobRow).where(JobRow.state.in_(UNFINISHED))
        if not cancel:
            session.execute(unfinished.values(state=QUEUED, dispatched_run=0, changes=JobRow.changes + 1))
            return
        session.execute(
            unfinished.values(
                state=CANCELLED, cancel_requested=True, ended_at=at, phase=cancelled_as(WHY),
                changes=JobRow.changes + 1,
            )
        )  # fmt: skip
    _settle_engine(jobs_url)


def _settle_engine(url: str) -> None:
    table, schema = "workflow_status", None
    if kind_of(url) == "postgresql":
        url = "postgresql+psycopg:" + url.removeprefix("postgresql:")
        schema = JOBS_SCHEMA
    else:
        if (path := sqlite_file(url)) is None or not path.exists():
            return
    engine = create_engine(url)
    try:
        with engine.begin() as connection:
            if not inspect(connection).has_table(table, schema=schema):
                return  # no job was ever handed over
            states = ", ".join(f"'{state}'" for state in ENGINE_UNFINISHED)
            statement: Any = text(
                f"UPDATE {schema + '.' if schema else ''}{table} SET status = 'CANCELLED' WHERE status IN ({states})"
            )
            connection.execute(statement)
    finally:
        engine.dispose()


def _columns(backup: Path, name: str) -> dict[str, list[str]]:
    path = backup / f"{name}.{COLUMNS}"
    if not path.exists():
        raise NotFoundError(f"{path} is not in the backup; take another one")
    return dict(json.loads(path.read_text(encoding="utf-8")))
