"""Make a backup while the service runs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sqlalchemy import func, inspect, select

from service.backup import controllers, manifest, postgres, sqlite
from service.backup.manifest import Manifest
from service.bootstrap import product_version
from service.config import Settings
from service.errors import NotFoundError, OutputError, StorageError
from service.exclusive import sole_use
from service.output import ready_folder
from service.private import PRIVATE, private_file, private_folder
from service.storage import migrate
from service.storage.blobs import Blobs
from service.storage.database import Database, sqlite_file
from service.storage.remote import opened
from service.storage.tables import Base

OWN, JOBS = "ambit", "jobs"
OWN_SCHEMA, JOBS_SCHEMA = "public", "dbos"
COLUMNS = "columns.json"


@dataclass
class _Copied:
    """Files of the store that are in the backup."""

    names: list[str] = field(default_factory=list)
    bytes: int = 0
    missing: list[str] = field(default_factory=list)


def create(settings: Settings, folder: Path, say: Callable[[str], None] = lambda _: None) -> tuple[Path, Manifest]:
    """Back up both databases, the controllers' files and the store into ``folder``.

    The job engine's database comes first, then our own, so that a job which the copied engine does not know to have
    ended has a row that is as new or newer. The store comes after them: a file is in the store before a row names it,
    so that every row of the copy finds its file.

    Returns
    -------
    path, manifest
        The folder of this backup, named by its time, and what it holds. ``manifest.missing`` names files that the
        store had lost or that were damaged, and those of controllers that cannot be read: the backup is good otherwise.

    Raises
    ------
    StorageError, OutputError
        There is no database or it cannot be read, or the folder cannot be written or is the service's own.
    ConflictError
        Another backup into the folder is being made.
    """
    _must_be_there(settings)
    _must_be_its_own(settings, folder)
    ready_folder(folder, PRIVATE)
    with sole_use(folder, "another backup", "wait for its end, or give this one another folder"):
        try:
            _clear(folder)
            return _create(settings, folder, say)
        except OSError as error:
            raise OutputError(
                f"cannot write the backup into {folder}: {error.strerror or error}; free space or choose another folder"
            ) from error


def _must_be_there(settings: Settings) -> None:
    """Refuse a home in which nothing was ever kept: backups of it would take the place of those that are removed."""
    source = sqlite_file(settings.database)
    if source is not None and not source.exists():
        raise StorageError(
            f"{source} does not exist, so there is nothing to back up; give the service's own --home, or AMBIT_HOME"
        )


def _must_be_its_own(settings: Settings, folder: Path) -> None:
    """Refuse a folder that the service keeps its own files in: a backup's store would be the store itself, no copy.

    A folder of its own below the home is none of them: another disk may be mounted there.
    """
    wanted, home = folder.resolve(), settings.home.resolve()
    _, root, local = opened(settings.store)
    kept = [path.resolve() for path in (settings.work, settings.controllers, *([Path(root)] if local else []))]
    if wanted == home or wanted / manifest.STORE in kept or any(wanted.is_relative_to(path) for path in kept):
        raise OutputError(f"{folder} is where the service keeps its own files; give the backups another folder")


def _clear(folder: Path) -> None:
    """Remove what backups that were killed left; nobody else is at work in the folder."""
    for part in folder.glob(".[0-9]*T[0-9]*Z.part"):
        shutil.rmtree(part)
    for copy in (folder / manifest.STORE).glob("??/*.part"):
        copy.unlink()


def _create(settings: Settings, folder: Path, say: Callable[[str], None]) -> tuple[Path, Manifest]:
    at = datetime.now(UTC)
    path = folder / f"{at:%Y%m%dT%H%M%SZ}"
    if path.exists():
        raise StorageError(f"{path} exists; wait a second and try again")
    part = private_folder(folder / f".{path.name}.part")  # webhooks' secrets are in it
    try:
        database = Database(settings.database)
        try:
            # tables of an older version stay as they are: the backup is what leads back to that version
            revision = migrate.known_revision(database) or migrate.upgrade(database)
            say("the databases")
            kinds = _databases(settings, part)
            rows, named = _rows(database, part)
            if migrate.revision(database) != revision:
                raise StorageError("the database was upgraded while it was backed up; back it up once more")
            unread = controllers.copy(settings.controllers, part)
            say("the store")
            copied = _store(Blobs(settings.store), folder / manifest.STORE, named)
            manifest.sidecar(part / manifest.NAMES, copied.names)
            made = Manifest(
                created=f"{at:%Y-%m-%dT%H:%M:%SZ}",
                product=product_version(),
                engine=version("dbos"),
                database=kinds[0],
                jobs_database=kinds[1],
                revision=revision,
                rows=rows,
                files={str(p.relative_to(part)): manifest.digest(p) for p in sorted(part.rglob("*")) if p.is_file()},
                blobs=len(copied.names),
                blob_bytes=copied.bytes,
                missing=(*copied.missing, *unread),
            )
        finally:
            database.close()
        manifest.write(part, made)
        _force(part, *part.rglob("*"))
        part.rename(path)
        _force(folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return path, made


def _force(*paths: Path) -> None:
    """Have the disk hold files and folders: a power failure shall not leave a backup's name without what it names."""
    for path in paths:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def prune(folder: Path, keep: int) -> list[Path]:
    """Remove all but the newest backups of a folder; what was removed. The shared store stays."""
    made = sorted(p for p in folder.glob("[0-9]*T[0-9]*Z") if (p / manifest.NAME).is_file())
    old = made[:-keep]
    for path in old:
        shutil.rmtree(path)
    return old


def kind_of(url: str) -> str:
    """Kind of the database at a URL: sqlite or postgresql."""
    return "sqlite" if url.startswith("sqlite") else "postgresql"


def _databases(settings: Settings, part: Path) -> tuple[str, str]:
    """Copy both databases; their kinds."""
    own, jobs = settings.database, settings.jobs_database
    kinds = kind_of(own), kind_of(jobs)
    for url, kind, name in ((jobs, kinds[1], JOBS), (own, kinds[0], OWN)):
        if kind == "sqlite":
            source = sqlite_file(url)
            if source is not None and source.exists():
                sqlite.copy(source, part / f"{name}.db")
                sqlite.as_one_file(part / f"{name}.db")
        elif not (name == JOBS and url == own):
            with postgres.snapshot(url) as connection:
                if name == OWN:
                    found = set(postgres.tables(connection, OWN_SCHEMA))
                    names = [t.name for t in Base.metadata.sorted_tables if t.name in found]
                    _dump(connection, OWN_SCHEMA, names, part / OWN)
                if url == jobs:  # the same snapshot, where both are in one database
                    _dump(connection, JOBS_SCHEMA, postgres.tables(connection, JOBS_SCHEMA), part / JOBS)
    there = (part / JOBS).exists() or (part / f"{JOBS}.db").exists()
    return kinds[0], kinds[1] if there else ""


def _dump(connection: Any, schema: str, names: list[str], folder: Path) -> None:
    if names:
        manifest.sidecar(folder.with_suffix(f".{COLUMNS}"), postgres.dump(connection, schema, names, folder))


def _rows(database: Database, part: Path) -> tuple[dict[str, int], set[str]]:
    """Rows by table, and the files of the store that they name."""
    copy = part / f"{OWN}.db"
    source = Database(f"sqlite:///{copy}") if copy.exists() else database
    rows: dict[str, int] = {}
    named: set[str] = set()
    try:
        there = inspect(source.engine)  # one of an older version may not have everything
        with source.read() as session:
            for table in (t for t in Base.metadata.sorted_tables if there.has_table(t.name)):
                rows[table.name] = session.scalar(select(func.count()).select_from(table)) or 0
                names = {column["name"] for column in there.get_columns(table.name)}
                for column in table.columns:
                    if column.name in names and column.name.endswith("_sha256") and table.name != "idempotency":
                        named |= {value for value in session.scalars(select(column)) if value}
    finally:
        if source is not database:
            source.close()
            sqlite.as_one_file(copy)
    return rows, named


def _store(blobs: Blobs, target: Path, named: set[str]) -> _Copied:
    """Copy what the backups' common store has not yet, or not whole: each file is checked against its name."""
    copied = _Copied()
    private_folder(target)
    there = set(blobs.names())
    for name in sorted(there | named):
        try:
            size = fetched(blobs, name, target / name[:2] / name)
        except (NotFoundError, StorageError):
            copied.missing.append(name)
            continue
        copied.names.append(name)
        copied.bytes += size
    _force(target, *(path for path in target.iterdir() if path.is_dir()))
    return copied


def fetched(blobs: Blobs, name: str, to: Path) -> int:
    """Bytes of a file of the store, once it lies at ``to`` and is what its name says; a damaged copy is replaced.

    Raises
    ------
    NotFoundError, StorageError
        The store has it not, or not whole.
    """
    if not to.is_file() or manifest.digest(to) != name:
        to.parent.mkdir(parents=True, exist_ok=True)
        temporary = to.with_suffix(".part")
        seen = sha256()
        try:
            with open(temporary, "wb", opener=private_file) as out:
                for chunk in blobs.chunks(name):
                    seen.update(chunk)
                    out.write(chunk)
                out.flush()
                os.fsync(out.fileno())
            if seen.hexdigest() != name:
                raise StorageError(f"the file {name} of the store is damaged")
            temporary.replace(to)
        finally:
            temporary.unlink(missing_ok=True)
    return to.stat().st_size
