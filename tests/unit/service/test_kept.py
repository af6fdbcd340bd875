"""What is kept of the database is never older than the database."""

import asyncio
import threading

import pytest
from sqlalchemy import text

from service.api.kept import Kept, Momentary
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


def test_of_many_who_ask_one_finds_out_and_none_waits_longer_than_was_said():
    found, asked = threading.Event(), []

    def slowly() -> int:
        asked.append(1)
        found.wait(20)
        return len(asked)

    async def ask() -> None:
        moment = Momentary(0.0, 0.1)
        for _ in range(2):  # those who come later too
            told = await asyncio.gather(*(moment.get(slowly) for _ in range(50)), return_exceptions=True)
            assert {type(answer) for answer in told} == {TimeoutError}
        assert asked == [1]
        found.set()
        while moment._answer is None or not moment._answer.done():
            await asyncio.sleep(0.01)
        assert await moment.get(slowly) == 2

    asyncio.run(ask())


def test_an_error_is_told_to_whoever_asks_and_is_a_moment_old_like_an_answer():
    now = [0.0]
    moment = Momentary(1.0, 5.0, clock=lambda: now[0])

    async def ask() -> None:
        with pytest.raises(ZeroDivisionError):
            await moment.get(lambda: 1 // 0)
        with pytest.raises(ZeroDivisionError):
            await moment.get(lambda: 1)
        now[0] = 1.0
        assert await moment.get(lambda: 1) == 1

    asyncio.run(ask())
