"""A service comes back from its backup as it was, on SQLite and on PostgreSQL, and no rotor moves because of it."""

import errno
import json
import os
import signal
import sqlite3
import threading
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from sqlalchemy import create_engine, select, text

from service.access import keys as rules
from service.backup import manifest
from service.backup.create import create, kind_of, prune
from service.backup.restore import WHY, restore
from service.config import Settings
from service.errors import ConflictError, DocumentError, OutputError, StorageError
from service.exclusive import sole_use
from service.jobs.engine import Dispatcher, workflow_id
from service.jobs.submission import hand_over, hand_over_all
from service.storage import jobs, migrate, schedules, workers
from service.storage import keys as key_rows
from service.storage.blobs import Blobs
from service.storage.database import Database, now
from service.storage.tables import AuditRow, Base, JobRow, Rig, ScheduleRow, WebhookRow, WorkerRow
from tests.support import command
from tests.support.command import wait_until
from tests.support.service_state import lived_in

OLDER = "0003"
"""A revision of our own tables before the newest."""


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.pg)])
def settings(request, tmp_path):
    """Makes settings of a service that is new."""
    with ExitStack() as stack:

        def make(name: str, kind: str = request.param) -> Settings:
            url = ""
            if kind == "postgresql":
                from tests.support.postgres import empty_database

                url = stack.enter_context(empty_database())
            return Settings(home=tmp_path / name, database_url=url)

        make.kind = request.param
        yield make


def engine_states(settings: Settings) -> list[str]:
    url, table = settings.jobs_database, "workflow_status"
    if kind_of(url) == "postgresql":
        url, table = url.replace("postgresql:", "postgresql+psycopg:"), "dbos.workflow_status"
    engine = create_engine(url)
    with engine.connect() as connection:
        found = sorted(connection.execute(text(f"SELECT status FROM {table}")).scalars())
    engine.dispose()
    return found


def everything(settings: Settings) -> dict[str, list[tuple]]:
    """All rows of our own tables."""
    database = Database(settings.database)
    with database.read() as session:
        found = {t.name: sorted(map(repr, session.execute(select(t)))) for t in Base.metadata.sorted_tables}
    database.close()
    return found


def test_a_service_comes_back_as_it_was(settings, tmp_path):
    old, new = settings("old"), settings("new")
    made = lived_in(old)
    before = everything(old)
    path, written = create(old, tmp_path / "backups")
    assert written.database == settings.kind
    assert (written.rows["rigs"], written.blobs, written.missing) == (1, 1, ())

    restore(new, path)
    after = everything(new)
    for table in set(before) - {"jobs", "audit", "workers"}:
        assert after[table] == before[table], table
    assert before["journal_parts"]
    assert Blobs(new.store).read(made["sha256"]) == b"an experiment" * 1000

    database = Database(new.database)
    with database.read() as session:
        states = {name: session.get(JobRow, made[name]).state for name in ("done", "queued", "running")}
        assert states == {"done": "done", "queued": "cancelled", "running": "cancelled"}
        assert {session.get(JobRow, made[name]).phase for name in ("queued", "running")} == {f"cancelled: {WHY}"}
        assert session.scalars(select(AuditRow).where(AuditRow.action == "service.restored")).one()
        row = key_rows.find(session, rules.id_of(made["key"]))
        assert rules.verify(made["key"], key_rows.record(row), now()).name == "laptop"
    database.close()
    assert engine_states(new) == ["CANCELLED", "CANCELLED"]


def test_a_backup_before_an_upgrade_leads_back_to_the_version_before(settings, tmp_path):
    """Tables of an older version stay as they are, in the service and in its backup."""
    old, new = settings("old"), settings("new")
    old.home.mkdir(exist_ok=True)
    database = Database(old.database)
    migrate.upgrade(database, OLDER)
    with database.write() as session:
        session.execute(
            text("INSERT INTO rigs (id, name, version, created_at, updated_at) VALUES ('rig_1', 'b', 1, :at, :at)"),
            {"at": now()},
        )
    path, written = create(old, tmp_path / "backups")
    assert (migrate.revision(database), written.revision, written.rows["rigs"]) == (OLDER, OLDER, 1)
    database.close()
    if settings.kind == "sqlite":  # what the older version finds once its backup is restored
        with closing(sqlite3.connect(path / "ambit.db")) as copy:
            assert copy.execute("SELECT version_num FROM alembic_version").fetchall() == [(OLDER,)]

    restore(new, path)
    database = Database(new.database)
    assert migrate.revision(database) == migrate.head()
    with database.read() as session:
        assert session.get(Rig, "rig_1").name == "b"
    database.close()


def test_jobs_go_on_only_when_asked_for(settings, tmp_path):
    old, new = settings("old"), settings("new")
    made = lived_in(old)
    path, _ = create(old, tmp_path / "backups")
    restore(new, path, resume_jobs=True)
    database = Database(new.database)
    with database.read() as session:
        assert session.get(JobRow, made["queued"]).state == "queued"
    database.close()
    assert engine_states(new) == ["ENQUEUED", "ENQUEUED"]


@pytest.mark.parametrize("resume_jobs", [False, True])
def test_messages_that_wait_for_a_webhook_are_sent_after_a_restore(tmp_path, resume_jobs):
    """Also one with which the engine was busy: whatever it did then, or forgets now, the next attempt is made."""
    old, new = Settings(home=tmp_path / "old"), Settings(home=tmp_path / "new")
    made = lived_in(old)
    database = Database(old.database)
    with database.write() as session:
        row = ScheduleRow(
            id="sch_1", rig_id=made["rig"], cron="0 6 * * *", options={}, enabled=True, webhook_url="https://h/",
            webhook_secret="", created_at=now(), updated_at=now(), created_by="local",
        )  # fmt: skip
        session.add(row)
        session.flush()
        for delivery_id in ("whd_1", "whd_2", "whd_3"):
            schedules.add_delivery(session, row, delivery_id, {"type": "health.missed"})
        schedules.dispatched(session, "whd_2", 1)
        session.get(WebhookRow, "whd_3").state = schedules.DELIVERED
        session.get(WebhookRow, "whd_3").next_at = None
    database.close()
    path, _ = create(old, tmp_path / "backups")
    restore(new, path, resume_jobs=resume_jobs)
    database = Database(new.database)
    with database.read() as session:
        assert schedules.undispatched(session, now()) == [("whd_1", 1), ("whd_2", 2)]
    database.close()


def test_what_is_there_is_not_given_up_unasked(settings, tmp_path):
    old, other = settings("old"), settings("other")
    lived_in(old)
    kept = lived_in(other)
    path, _ = create(old, tmp_path / "backups")
    with pytest.raises(ConflictError, match="--replace"):
        restore(other, path)
    assert kept["rig"] in str(everything(other)["rigs"])
    restore(other, path, replace=True)
    assert kept["rig"] not in str(everything(other)["rigs"])


def test_a_service_that_works_is_not_replaced(settings, tmp_path):
    old, other = settings("old"), settings("other")
    lived_in(old)
    path, _ = create(old, tmp_path / "backups")
    database = Database(other.database)
    migrate.upgrade(database)
    with database.write() as session:
        workers.sign_on(session, "w1", "wrk_1")
        session.flush()
        session.get(WorkerRow, "w1").process = os.getppid()
    database.close()
    with pytest.raises(ConflictError, match="w1"):
        restore(other, path, replace=True)


def test_a_damaged_backup_changes_nothing(settings, tmp_path):
    old, new = settings("old"), settings("new")
    lived_in(old)
    path, written = create(old, tmp_path / "backups")
    victim = path / max(written.files, key=lambda name: (path / name).stat().st_size)
    raw = bytearray(victim.read_bytes())
    raw[len(raw) // 2] ^= 1
    victim.write_bytes(raw)
    with pytest.raises(StorageError, match="damaged"):
        restore(new, path)
    victim.unlink()
    with pytest.raises(StorageError, match="missing"):
        restore(new, path)


@pytest.mark.pg
def test_from_one_machine_to_postgresql(tmp_path):
    from tests.support.postgres import empty_database

    old = Settings(home=tmp_path / "old")
    made = lived_in(old)
    before = everything(old)
    path, _ = create(old, tmp_path / "backups")
    with empty_database() as url:
        new = Settings(home=tmp_path / "new", database_url=url)
        restore(new, path)
        after = everything(new)
        for table in set(before) - {"jobs", "audit", "workers"}:
            assert after[table] == before[table], table
        assert engine_states(new) == []
        back = Settings(home=tmp_path / "back")
        pg_backup, _ = create(new, tmp_path / "backups2")
        with pytest.raises(StorageError, match="PostgreSQL"):
            restore(back, pg_backup)
        assert Blobs(new.store).has(made["sha256"])


def test_a_backup_without_one_of_its_files_changes_nothing_however_many_others_there_are(tmp_path):
    settings, new = Settings(home=tmp_path / "home"), Settings(home=tmp_path / "new")
    made = lived_in(settings)
    path, _ = create(settings, tmp_path / "backups")
    Blobs(settings.store).put(b"of a later backup")
    store = tmp_path / "backups" / "store"
    (later,) = set(Blobs(settings.store).names()) - {made["sha256"]}
    (store / later[:2]).mkdir(exist_ok=True)
    (store / later[:2] / later).write_bytes(b"of a later backup")
    (store / made["sha256"][:2] / made["sha256"]).unlink()
    with pytest.raises(StorageError, match=made["sha256"]):
        restore(new, path)
    assert not Path(new.store).exists()


def test_jobs_that_change_while_the_databases_are_copied_end_or_go_on(tmp_path, monkeypatch):
    from service.backup import sqlite

    old, new = Settings(home=tmp_path / "old"), Settings(home=tmp_path / "new")
    made = lived_in(old)
    database, dispatcher = Database(old.database), Dispatcher(old)
    submitted = []

    def copy_and_change(source: Path, target: Path, copy=sqlite.copy) -> None:
        copy(source, target)
        if submitted:
            return
        with database.write() as session:
            jobs.finish(session, made["running"], 1, jobs.DONE, {})
            submitted.append(jobs.submit(session, "experiment", made["rig"], 1, "laptop"))
        assert hand_over(database, dispatcher, submitted[0])
        with closing(sqlite3.connect(old.jobs_database.removeprefix("sqlite:///"))) as engine, engine:
            engine.execute(
                "UPDATE workflow_status SET status = 'SUCCESS' WHERE workflow_uuid = ?",
                (workflow_id(made["running"], 1),),
            )

    monkeypatch.setattr(sqlite, "copy", copy_and_change)
    path, _ = create(old, tmp_path / "backups")
    monkeypatch.undo()
    dispatcher.close()
    database.close()
    restore(new, path, resume_jobs=True)
    database, dispatcher = Database(new.database), Dispatcher(new)
    with database.read() as session:
        assert session.get(JobRow, made["running"]).state == "done"
    assert hand_over_all(database, dispatcher) == 2
    with closing(sqlite3.connect(new.jobs_database.removeprefix("sqlite:///"))) as engine:
        known = {row[0] for row in engine.execute("SELECT workflow_uuid FROM workflow_status")}
    assert {workflow_id(made["queued"], 1), workflow_id(submitted[0].id, 1)} <= known
    dispatcher.close()
    database.close()


def test_a_backup_is_made_while_the_service_writes(tmp_path):
    settings = Settings(home=tmp_path / "home")
    lived_in(settings)
    database = Database(settings.database)
    ended = threading.Event()
    written = []

    def write() -> None:
        while not ended.is_set():
            with database.write() as session:
                jobs.submit(session, "experiment", session.scalars(select(Rig.id)).one(), 1, "laptop")
            written.append(1)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        paths = [create(settings, tmp_path / f"backups{k}")[0] for k in range(3)]
    finally:
        ended.set()
        writer.join()
        database.close()
    assert len(written) > 3
    counts = [manifest.read(path).rows["jobs"] for path in paths]
    assert counts == sorted(counts)
    with closing(sqlite3.connect(paths[-1] / "ambit.db")) as copy:
        assert copy.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_a_file_that_the_store_lost_is_named_and_the_rest_is_kept(tmp_path):
    settings = Settings(home=tmp_path / "home")
    made = lived_in(settings)
    Path(settings.store, made["sha256"][:2], made["sha256"]).write_bytes(b"rotten")
    path, written = create(settings, tmp_path / "backups")
    assert written.missing == (made["sha256"],)
    restore(Settings(home=tmp_path / "new"), path)


@pytest.mark.parametrize("damage", [b"", b"an experimenT" * 1000], ids=["emptied", "of the same size"])
def test_a_file_that_the_backups_lost_is_fetched_again(tmp_path, damage):
    settings, new = Settings(home=tmp_path / "home"), Settings(home=tmp_path / "new")
    sha256 = lived_in(settings)["sha256"]
    copy = tmp_path / "backups" / "store" / sha256[:2] / sha256
    copy.parent.mkdir(parents=True)
    copy.write_bytes(damage)
    path, written = create(settings, tmp_path / "backups")
    assert written.missing == ()
    assert list(copy.parent.iterdir()) == [copy]
    restore(new, path)
    assert Blobs(new.store).read(sha256) == b"an experiment" * 1000


def test_a_file_that_both_lost_is_named(tmp_path):
    settings = Settings(home=tmp_path / "home")
    sha256 = lived_in(settings)["sha256"]
    create(settings, tmp_path / "backups")[0].rename(tmp_path / "backups" / "20010101T000000Z")
    for store in (Path(settings.store), tmp_path / "backups" / "store"):
        (store / sha256[:2] / sha256).write_bytes(b"")
    path, written = create(settings, tmp_path / "backups")
    assert written.missing == (sha256,)
    restore(Settings(home=tmp_path / "new"), path)


@pytest.mark.parametrize("folder", [".", "store", "store/backups", "work", "controllers", "../home/work/.."])
def test_a_backup_is_not_made_among_the_files_of_the_service(tmp_path, folder):
    settings = Settings(home=tmp_path / "home")
    lived_in(settings)
    before = sorted(settings.home.rglob("*"))
    with pytest.raises(OutputError, match="give the backups another folder"):
        create(settings, settings.home / folder)
    assert sorted(settings.home.rglob("*")) == before
    assert create(settings, settings.home / "backups")[0].is_dir(), "as compose.yaml mounts them"


def test_nobody_else_reads_a_backup(tmp_path):
    """It holds webhooks' secrets and the addresses of rigs, its store what was measured."""
    old, folder = Settings(home=tmp_path / "old"), tmp_path / "backups"
    lived_in(old)
    path, _ = create(old, folder)
    files = [each for each in (folder / manifest.STORE).rglob("*") if each.is_file()]
    assert files
    for one in (folder, path, folder / manifest.STORE, *files):
        assert one.stat().st_mode & 0o077 == 0, one


def controllers(settings):
    return settings.home / "controllers"


def with_controllers(settings):
    """Files that controllers' URLs name: a map, and a key in a folder of its own."""
    (controllers(settings) / "tls").mkdir(parents=True)
    (controllers(settings) / "vendor.toml").write_text("a map")
    (controllers(settings) / "tls" / "host.key").write_text("a key")
    lived_in(settings)


def test_files_that_controllers_are_named_by_come_back_for_the_service_alone(tmp_path):
    old, new = Settings(home=tmp_path / "old"), Settings(home=tmp_path / "new")
    with_controllers(old)
    path, _ = create(old, tmp_path / "backups")
    restore(new, path)
    assert (controllers(new) / "vendor.toml").read_text() == "a map"
    assert (controllers(new) / "tls" / "host.key").read_text() == "a key"
    for folder in (path / "controllers", controllers(new)):
        for one in (folder, *folder.rglob("*")):
            assert one.stat().st_mode & 0o077 == 0, one


def test_files_that_controllers_are_named_by_are_given_up_only_when_asked_for(tmp_path):
    old, new = Settings(home=tmp_path / "old"), Settings(home=tmp_path / "new")
    with_controllers(old)
    path, _ = create(old, tmp_path / "backups")
    controllers(new).mkdir(parents=True)
    (controllers(new) / "vendor.toml").write_text("a newer map")
    (controllers(new) / "other.toml").write_text("of another rig")
    with pytest.raises(ConflictError, match=r"vendor\.toml is another file than the backup's; --replace"):
        restore(new, path)
    assert [one.name for one in controllers(new).iterdir() if one.is_dir()] == []
    restore(new, path, replace=True)
    assert (controllers(new) / "vendor.toml").read_text() == "a map"
    assert (controllers(new) / "other.toml").read_text() == "of another rig"
    restore(new, path, replace=True)


def test_only_files_that_a_controller_may_be_named_by_are_in_a_backup(tmp_path, monkeypatch):
    """A link that leads elsewhere names none; one that cannot be read is told, and the backup is good otherwise."""
    old = Settings(home=tmp_path / "old")
    with_controllers(old)
    (tmp_path / "secret").write_text("of the machine")
    (controllers(old) / "elsewhere").symlink_to(tmp_path / "secret")
    (controllers(old) / "latest.toml").symlink_to(controllers(old) / "vendor.toml")
    read = Path.read_bytes

    def refused(path):
        if path.name == "host.key":
            raise PermissionError(errno.EACCES, "Permission denied")
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", refused)
    path, written = create(old, tmp_path / "backups")
    assert written.missing == ("controllers/tls/host.key",)
    assert {one.name for one in (path / "controllers").iterdir()} == {"vendor.toml", "latest.toml"}


def test_a_backup_has_its_name_once_the_disk_has_all_of_it(tmp_path, monkeypatch):
    old, folder = Settings(home=tmp_path / "old"), tmp_path / "backups"
    lived_in(old)
    fsync, rename, forced, before = os.fsync, Path.rename, set(), set()
    monkeypatch.setattr(os, "fsync", lambda of: (forced.add(os.fstat(of).st_ino), fsync(of)))
    monkeypatch.setattr(Path, "rename", lambda self, to: (before.update(forced), rename(self, to))[1])
    path, _ = create(old, folder)
    for one in (path, *path.rglob("*"), folder / manifest.STORE, *(folder / manifest.STORE).rglob("*")):
        assert one.stat().st_ino in before, one
    assert folder.stat().st_ino in forced


def test_a_backup_onto_a_full_disk_says_so_and_leaves_nothing(tmp_path, monkeypatch):
    old, folder = Settings(home=tmp_path / "old"), tmp_path / "backups"
    lived_in(old)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match=f"backup into {folder}: No space left on device; free space"):
        create(old, folder)
    assert not list(folder.glob("*T*Z*")) + list(folder.glob(".*T*Z*"))


def test_what_a_killed_backup_left_goes_with_the_next_one(tmp_path):
    settings, folder = Settings(home=tmp_path / "home"), tmp_path / "backups"
    lived_in(settings)
    (folder / "store" / "ab").mkdir(parents=True)
    (folder / "store" / "ab" / f"{'ab' * 32}.part").write_bytes(b"half a file")
    (folder / ".20260101T000000Z.part" / "ambit").mkdir(parents=True)
    with sole_use(folder, "another backup", "wait"), pytest.raises(ConflictError, match="another backup is at work"):
        create(settings, folder)
    assert (folder / ".20260101T000000Z.part").exists()
    path, _ = create(settings, folder)
    assert {p.name for p in folder.iterdir()} == {path.name, "store"}
    assert not list((folder / "store").glob("**/*.part"))


def test_a_backup_that_is_told_to_end_leaves_nothing_of_itself(tmp_path, monkeypatch):
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_HOME", str(tmp_path / "home"))
    settings, folder = Settings(home=tmp_path / "home"), tmp_path / "backups"
    lived_in(settings)
    (Path(settings.store) / "00").mkdir()
    os.mkfifo(Path(settings.store) / "00" / ("00" * 32))  # a file that takes for ever to read
    running = command.Running("db", "backup", "--out", folder)
    try:
        wait_until(lambda: (folder / "store" / "00").exists(), "the copy of the store")
        assert list(folder.glob(".*.part"))
        running.interrupt(signal.SIGTERM)
        assert running.wait(20) == 1
        assert "stopped by the user" in "".join(running.said)
    finally:
        running.end()
    assert {p.name for p in folder.iterdir()} == {"store"}


def test_an_unfinished_backup_is_no_backup(tmp_path):
    (tmp_path / "20260101T000000Z").mkdir()
    with pytest.raises(DocumentError, match=r"manifest\.json"):
        restore(Settings(home=tmp_path / "new"), tmp_path / "20260101T000000Z")


def test_a_home_in_which_no_service_was_is_not_backed_up(tmp_path):
    """Its empty backups would be the newest ones, and those of the service would be removed."""
    wrong = Settings(home=tmp_path / "wrong")
    with pytest.raises(StorageError, match=r"wrong/ambit\.db does not exist, so there is nothing to back up"):
        create(wrong, tmp_path / "backups")
    assert not (tmp_path / "backups").exists()
    assert not wrong.home.exists()


def test_old_backups_are_removed_and_share_their_files(tmp_path):
    settings = Settings(home=tmp_path / "home")
    lived_in(settings)
    path, _ = create(settings, tmp_path / "backups")
    for year in (2001, 2002):
        path.rename(older := tmp_path / "backups" / f"{year}0101T000000Z")
        path, _ = create(settings, tmp_path / "backups")
    assert len(list((tmp_path / "backups" / "store").glob("??/*"))) == 1
    assert [p.name[:4] for p in prune(tmp_path / "backups", 2)] == ["2001"]
    assert older.exists()


def test_the_commands(tmp_path, monkeypatch):
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_HOME", str(tmp_path / "home"))
    upgraded = json.loads(command.ambit("db", "upgrade", "--json").stdout)
    assert upgraded == {"before": "", "after": migrate.head()}
    lived_in(Settings(home=tmp_path / "home"))
    made = command.ambit("db", "backup", "--out", tmp_path / "backups", "--keep", 3)
    assert made.returncode == 0, made.stderr
    monkeypatch.setitem(command.ENVIRONMENT, "AMBIT_HOME", str(tmp_path / "new"))
    restored = command.ambit("db", "restore", made.stdout.strip())
    assert restored.stdout.startswith("restored the state of")
    assert "--replace" in command.refusal("db", "restore", made.stdout.strip())
    assert everything(Settings(home=tmp_path / "new"))["rigs"] == everything(Settings(home=tmp_path / "home"))["rigs"]
