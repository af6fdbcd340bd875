"""Connections that wait in a pool: one that the server has ended is replaced, the others are kept and not asked."""

import pytest
from sqlalchemy import text

from tests.support.databases import migrated

pytestmark = pytest.mark.pg
WHO = text("SELECT pg_backend_pid()")
END = text("SELECT pg_terminate_backend(:pid, 5000)")
"""True once the process is gone."""


@pytest.fixture
def database(tmp_path):
    with migrated("postgresql", tmp_path) as found:
        yield found


def test_a_connection_that_the_server_ended_is_replaced_before_it_is_used(database):
    with database.read() as outer, database.read() as inner:
        ended, ends = inner.scalar(WHO), outer.scalar(WHO)
    with database.read() as session:
        assert session.scalar(WHO) in (ended, ends)
        mine = session.scalar(WHO)
        assert session.scalar(END, {"pid": ended if mine == ends else ends})
    with database.write() as first, database.write() as second:  # one of them had the ended connection
        found = {first.scalar(WHO), second.scalar(WHO)}
    assert mine in found
    assert found != {ended, ends}


def test_a_connection_that_stands_is_used_again_and_nobody_asks_whether_it_does(database):
    with database.read() as session:
        before = session.scalar(WHO)
        asked = session.execute(text("SELECT query_start FROM pg_stat_activity WHERE pid = pg_backend_pid()")).scalar()
    taken = database.engine.raw_connection()
    try:
        assert taken.driver_connection.info.backend_pid == before
        with database.read() as other:
            last = text("SELECT query_start FROM pg_stat_activity WHERE pid = :pid")
            assert other.scalar(last, {"pid": before}) == asked
    finally:
        taken.close()
