"""What is kept of the database is never older than the database."""

import asyncio

import pytest
from sqlalchemy import text

from service.api.kept import Kept
from service.storage.database import Database


@pytest.fixture
def database(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'a.db'}")
    with database.write() as session:
        session.execute(text("CREATE TABLE t (x INTEGER)"))
        session.execute(text("INSERT INTO t VALUES (1)"))
    yield database
    database.close()


class Reader:
    """Reads the one value there is, and counts how often."""

    def __init__(self, database):
        self.database, self.reads = database, 0

    def __call__(self) -> int:
        self.reads += 1
        with self.database.read() as session:
            return session.scalar(text("SELECT x FROM t"))


def test_what_has_not_changed_is_read_once(database):
    kept, read = Kept(database), Reader(database)
    assert [asyncio.run(kept.get("x", read)) for _ in range(5)] == [1] * 5
    assert read.reads == 1


@pytest.mark.parametrize("by_another_process", [False, True])
def test_a_change_is_seen_at_once_whoever_makes_it(database, tmp_path, by_another_process):
    kept, read = Kept(database), Reader(database)
    other = Database(f"sqlite:///{tmp_path / 'a.db'}") if by_another_process else database
    for value in range(2, 6):
        asyncio.run(kept.get("x", read))
        with other.write() as session:
            session.execute(text(f"UPDATE t SET x = {value}"))
        assert asyncio.run(kept.get("x", read)) == value
    if by_another_process:
        other.close()


def test_a_change_while_it_is_read_is_not_missed(database):
    kept, read = Kept(database), Reader(database)

    def slowly() -> int:
        value = read()
        with database.write() as session:
            session.execute(text("UPDATE t SET x = 7"))
        return value

    assert asyncio.run(kept.get("x", slowly)) == 1
    assert asyncio.run(kept.get("x", read)) == 7


def test_a_database_that_cannot_tell_is_read_every_time(database, monkeypatch):
    monkeypatch.setattr(database, "mark", lambda: None)
    kept, read = Kept(database), Reader(database)
    assert [asyncio.run(kept.get("x", read)) for _ in range(3)] == [1] * 3
    assert read.reads == 3


def test_no_more_is_kept_than_was_said(database):
    kept, read = Kept(database, largest=2), Reader(database)
    for name in ("a", "b", "c", "c", "b", "a"):
        asyncio.run(kept.get(name, read))
    assert read.reads == 4  # c and b were still there
