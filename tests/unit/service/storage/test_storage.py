"""Tables, files, workers' names and rigs' versions."""

import errno
import hashlib
import os
import threading
import time
from datetime import timedelta

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import text, update
from sqlalchemy.exc import OperationalError

from service.errors import ConflictError, NotFoundError, StorageError
from service.storage import migrate, rigs, workers
from service.storage.blobs import Blobs
from service.storage.database import Database, now, use_wal
from service.storage.ids import new_id
from service.storage.tables import Base, WorkerRow
from tests.support.databases import BOTH, migrated


@pytest.fixture(params=BOTH)
def database(request, tmp_path):
    with migrated(request.param, tmp_path) as found:
        yield found


def test_migrations_make_the_tables_that_the_program_knows(database):
    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    assert migrate.revision(database) == migrate.head()


def test_a_newer_schema_is_refused(database):
    with database.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(StorageError, match="9999"):
        migrate.upgrade(database)


def test_nobody_else_reads_the_tables_of_a_new_service(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'home' / 'ambit.db'}")
    migrate.upgrade(database)
    made = {path.name: path.stat().st_mode & 0o777 for path in (tmp_path / "home").iterdir()}
    database.close()
    assert made == {"ambit.db": 0o600, "ambit.db-wal": 0o600, "ambit.db-shm": 0o600}
    assert (tmp_path / "home").stat().st_mode & 0o777 == 0o700


def test_a_folder_and_tables_that_others_may_read_stay_so(tmp_path):
    tmp_path.chmod(0o755)
    path = tmp_path / "ambit.db"
    path.touch()
    path.chmod(0o644)
    use_wal(path)
    assert (tmp_path.stat().st_mode & 0o777, path.stat().st_mode & 0o777) == (0o755, 0o644)


def test_several_processes_may_migrate_at_once(tmp_path):
    url = f"sqlite:///{tmp_path / 'ambit.db'}"
    failed = []

    def upgrade():
        database = Database(url)
        try:
            migrate.upgrade(database)
        except Exception as error:
            failed.append(error)
        finally:
            database.close()

    threads = [threading.Thread(target=upgrade) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []


def test_several_processes_may_begin_with_a_new_file_at_once(tmp_path):
    refused = []

    def begin(path):
        try:
            use_wal(path)
        except StorageError as error:
            refused.append(error)

    for k in range(60):
        threads = [threading.Thread(target=begin, args=(tmp_path / f"{k}.db",)) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert refused == []


def test_a_change_is_tried_again_while_the_database_is_away(database):
    tries = []

    def change(session):
        tries.append(1)
        if len(tries) < 3:
            raise OperationalError("UPDATE", {}, Exception("server closed the connection"))
        return "done"

    assert database.surely(change) == "done"
    with pytest.raises(OperationalError):
        database.surely(lambda session: (_ for _ in ()).throw(OperationalError("", {}, Exception())), lambda: True)


def test_a_rig_keeps_its_versions(database):
    with database.write() as session:
        rig = rigs.create(session, "bench", "sheet 1", "modbus://a:1", "", "me")
        rigs.change(session, rig, "sheet 2", "modbus://a:1", "new magnets", "you")
        rigs.change(session, rig, "sheet 2", "modbus://a:1", "new magnets", "you")  # nothing new
        assert [(v.version, v.datasheet, v.created_by) for v in rigs.versions(session, rig).items] == [
            (2, "sheet 2", "you"),
            (1, "sheet 1", "me"),
        ]
        with pytest.raises(ConflictError, match="bench"):
            rigs.create(session, "bench", "", "", "", "me")
        with pytest.raises(NotFoundError, match="1 to 2"):
            rigs.version(session, rig, 3)


def test_a_workers_name_is_held_while_it_lives(database, monkeypatch):
    with database.write() as session:
        workers.sign_on(session, "w1", "wrk_1")
        session.execute(update(WorkerRow).values(machine="another"))
    with database.write() as session, pytest.raises(ConflictError, match="another"):
        workers.sign_on(session, "w1", "wrk_2")
    with database.write() as session:
        assert workers.beat(session, "w1", "wrk_1")
        session.execute(update(WorkerRow).values(beat_at=now() - timedelta(seconds=60)))
        assert workers.silent(session, 30) == ["w1"]
        workers.sign_on(session, "w1", "wrk_2")
        assert not workers.beat(session, "w1", "wrk_1")  # the first one finds out
        assert workers.silent(session, 30) == []


def test_a_dead_process_of_this_machine_holds_no_name(database):
    with database.write() as session:
        workers.sign_on(session, "w1", "wrk_1")
        session.execute(update(WorkerRow).values(process=2**22 - 1))
        workers.sign_on(session, "w1", "wrk_2")
        assert not workers.beat(session, "w1", "wrk_1")
        assert workers.beat(session, "w1", "wrk_2")


def test_files_are_named_by_their_content(tmp_path):
    blobs = Blobs(str(tmp_path / "store"))
    content = b"x" * 3_000_000
    sha256 = blobs.put(content)
    assert sha256 == hashlib.sha256(content).hexdigest()
    (tmp_path / "file").write_bytes(content)
    assert blobs.put_file(tmp_path / "file") == sha256
    assert blobs.read(sha256) == content == b"".join(blobs.chunks(sha256))
    assert blobs.size(sha256) == len(content)
    assert blobs.fetch(sha256, tmp_path / "a" / "copy").read_bytes() == content
    assert not list((tmp_path / "store" / "incoming").iterdir())
    with pytest.raises(NotFoundError, match="backup"):
        blobs.read("0" * 64)


def test_a_damaged_file_is_given_to_nobody_whole(tmp_path):
    blobs = Blobs(str(tmp_path / "store"))
    content = b"x" * 3_000_000
    sha256 = blobs.put(content)
    with (tmp_path / "store" / sha256[:2] / sha256).open("r+b") as file:
        file.seek(10)
        file.write(b"y")
    got = []
    with pytest.raises(StorageError, match="damaged; restore it"):
        got.extend(blobs.chunks(sha256))
    assert sum(map(len, got)) < len(content)
    with pytest.raises(StorageError, match="damaged"):
        blobs.fetch(sha256, tmp_path / "copy")
    (tmp_path / "whole").write_bytes(content)
    blobs.put_file(tmp_path / "whole", repair=True)
    assert b"".join(blobs.chunks(sha256)) == content


def test_what_does_not_fit_leaves_nothing_on_the_disk(tmp_path, monkeypatch):
    blobs = Blobs(str(tmp_path / "store"))
    (tmp_path / "file").write_bytes(b"x" * 1000)

    def half(path, target):
        target.write(b"x" * 500)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("service.storage.blobs._copy", half)
    with pytest.raises(StorageError, match="free space"):
        blobs.put_file(tmp_path / "file")
    assert [p for p in (tmp_path / "store").rglob("*") if p.is_file()] == []


def test_what_a_killed_writer_left_goes_and_what_is_being_written_stays(tmp_path):
    blobs = Blobs(str(tmp_path / "store"))
    blobs.tidy(timedelta(days=1))  # nothing was ever kept
    kept = blobs.put(b"content")
    left, under_way = (tmp_path / "store" / "incoming" / name for name in ("a.1", "b.2"))
    for path in (left, under_way):
        path.write_bytes(b"half a file")
    killed = time.time() - 86_460.0
    os.utime(left, (killed, killed))
    blobs.tidy(timedelta(days=1))
    assert (left.exists(), under_way.exists(), blobs.read(kept)) == (False, True, b"content")


def test_any_fsspec_url_will_do():
    blobs = Blobs("memory://ambit-test")
    assert blobs.read(blobs.put(b"content")) == b"content"
    with pytest.raises(StorageError, match="nonsense"):
        Blobs("nonsense://x")


def test_ids_sort_by_time():
    made = [new_id("job") for _ in range(50)]
    assert sorted(made, key=lambda i: i[:14]) == made
    assert len(set(made)) == 50
