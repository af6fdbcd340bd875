"""An upgrade keeps what was there: migrations run forward on a copy of every schema that was ever delivered.

``tests/support/schemas/<revision>.sql`` are databases as an earlier version left them. They never change: a new form of
the tables is a new revision, and a new file here when the next one comes.
"""

import re
import sqlite3
import subprocess
import sys
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text

from service.errors import StorageError
from service.storage import keys, migrate, schedules
from service.storage.database import Database, now
from service.storage.tables import AuditRow, Base, ExperimentRow, JobRow, JournalPart, KeyRow, Rig
from tests.support import command

SCHEMAS = sorted((Path(__file__).parents[1] / "support" / "schemas").glob("*.sql"))
REVISIONS = [path.stem for path in SCHEMAS]
KINDS = ["sqlite", pytest.param("postgresql", marks=pytest.mark.pg)]


def as_delivered(folder: Path, sql: Path) -> Path:
    path = folder / "ambit.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(sql.read_text())
    return path


def differences(database: Database) -> list:
    with database.engine.connect() as connection:
        return compare_metadata(MigrationContext.configure(connection, opts={"compare_type": True}), Base.metadata)


@contextmanager
def opened(url: str):
    database = Database(url)
    try:
        yield database
    finally:
        database.close()


@contextmanager
def new(kind: str, folder: Path):
    if kind == "sqlite":
        with opened(f"sqlite:///{folder / 'new.db'}") as database:
            yield database
    else:
        from tests.support.postgres import empty_database

        with empty_database() as url, opened(url) as database:
            yield database


def kept(database: Database) -> None:
    """Everything that the delivered databases hold is as it was."""
    with database.read() as session:
        assert session.get(Rig, "rig_1").name == "bench äöü"
        assert session.get(ExperimentRow, "exp_1").summary == {"axes": ["xA"]}
        job = session.get(JobRow, "job_1")
        assert (job.state, job.result, job.percent) == ("done", {"model": "mod_1"}, 100.0)
        assert session.get(JournalPart, ("job_1", 0)).content == bytes(range(10))
        assert session.get(AuditRow, "aud_1").at.isoformat() == "2026-01-02T03:04:05.678901+00:00"
        assert keys.record(session.get(KeyRow, "key_1")).scope == "admin"


@pytest.mark.parametrize("sql", SCHEMAS, ids=REVISIONS)
def test_a_delivered_database_is_upgraded_with_all_that_it_holds(tmp_path, sql):
    with opened(f"sqlite:///{as_delivered(tmp_path, sql)}") as database:
        assert migrate.revision(database) == sql.stem
        assert migrate.upgrade(database) == migrate.head()
        kept(database)
        assert differences(database) == []
        assert migrate.upgrade(database) == migrate.head()  # once more changes nothing


def test_messages_that_wait_for_a_webhook_go_on_after_an_upgrade(tmp_path):
    with opened(f"sqlite:///{as_delivered(tmp_path, SCHEMAS[REVISIONS.index('0004')])}") as database:
        migrate.upgrade(database)
        with database.read() as session:
            assert schedules.undispatched(session, now()) == [("whd_1", 4)]


@pytest.mark.pg
@pytest.mark.parametrize("sql", SCHEMAS, ids=REVISIONS)
def test_the_same_on_postgresql(tmp_path, sql):
    with new("postgresql", tmp_path) as database, closing(sqlite3.connect(as_delivered(tmp_path, sql))) as old:
        migrate.upgrade(database, sql.stem)
        old.row_factory = sqlite3.Row
        booleans = {"complete", "cancel_requested", "enabled", "dispatched"}
        with database.write() as session:
            for table in [t.name for t in Base.metadata.sorted_tables if inspect(database.engine).has_table(t.name)]:
                for row in old.execute(f"SELECT * FROM {table}"):
                    values = {k: bool(row[k]) if k in booleans else row[k] for k in row.keys()}  # noqa: SIM118
                    names = ", ".join(f'"{k}"' for k in values)
                    marks = ", ".join(
                        f"CAST(:{k} AS timestamp) AT TIME ZONE 'UTC'" if re.search(r"(_at|^at)$", k) else f":{k}"
                        for k in values
                    )
                    casts = marks
                    for k in [k for k, v in values.items() if isinstance(v, str) and v.startswith("{")]:
                        casts = re.sub(rf":{k}\b", f"CAST(:{k} AS jsonb)", casts)
                    session.execute(text(f"INSERT INTO {table} ({names}) VALUES ({casts})"), values)
        assert migrate.upgrade(database) == migrate.head()
        kept(database)
        assert differences(database) == []


@pytest.mark.parametrize("sql", SCHEMAS, ids=REVISIONS)
def test_a_delivered_revision_is_never_changed(tmp_path, sql):
    """Today's migrations up to a revision make the very tables that were delivered with it."""
    with opened(f"sqlite:///{tmp_path / 'made.db'}") as database:
        migrate.upgrade(database, sql.stem)

    def tables(path: Path) -> list[str]:
        with closing(sqlite3.connect(path)) as connection:
            found = connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()
        return [" ".join(row[0].split()) for row in found]

    (tmp_path / "old").mkdir()
    assert tables(tmp_path / "made.db") == tables(as_delivered(tmp_path / "old", sql))


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_database_has_the_tables_that_the_product_knows(tmp_path, kind):
    with new(kind, tmp_path) as database:
        migrate.upgrade(database)
        assert differences(database) == []


def test_revisions_are_one_line_and_every_one_but_the_newest_is_kept_as_it_was_delivered():
    scripts = ScriptDirectory.from_config(migrate._config())
    order = [script.revision for script in scripts.walk_revisions()][::-1]
    assert len(scripts.get_heads()) == 1
    assert order[:-1] == REVISIONS
    assert migrate._known() == order, "the names of the files tell it without alembic"


def test_where_there_is_nothing_to_upgrade_alembic_is_not_loaded(tmp_path):
    url = f"sqlite:///{tmp_path / 'new.db'}"
    with opened(url) as database:
        migrate.upgrade(database)
    code = (
        "import sys; from service.storage import migrate; from service.storage.database import Database; "
        f"print(migrate.upgrade(Database({url!r})), 'alembic' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [migrate.head(), "False"]


def test_a_database_of_a_newer_version_is_left_alone(tmp_path):
    path = as_delivered(tmp_path, SCHEMAS[0])
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    with opened(f"sqlite:///{path}") as database, pytest.raises(StorageError, match="newer version"):
        migrate.upgrade(database)


def test_the_command_upgrades_both_databases(tmp_path, monkeypatch):
    (tmp_path / "home").mkdir()
    as_delivered(tmp_path / "home", SCHEMAS[0])
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_HOME", str(tmp_path / "home"))
    done = command.ambit("db", "upgrade")
    assert done.stdout == f"revision {SCHEMAS[0].stem} -> {migrate.head()}\n"
    with closing(sqlite3.connect(tmp_path / "home" / "jobs.db")) as jobs:
        assert jobs.execute("SELECT count(*) FROM workflow_status").fetchone() == (0,)
    assert "laptop" in command.ambit("keys", "list").stdout
