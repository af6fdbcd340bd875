"""A database that does not answer is told when that changes, and a library that repeats itself once in a minute."""

import logging

import pytest
from sqlalchemy.exc import OperationalError

from service.jobs.outage import Outage, Repeats
from service.storage.ids import new_id

FULL = OperationalError("INSERT", {}, Exception("database or disk is full"))
GONE = OperationalError("INSERT", {}, Exception("connection refused"))


def test_an_outage_is_told_when_it_begins_when_its_reason_changes_and_when_it_ends(caplog):
    outage = Outage(logging.getLogger("a"), "job job_1")
    for error in (FULL, FULL, FULL, GONE, GONE):
        outage.away(error)
    outage.over()
    outage.over()
    outage.away(FULL)
    lines = [record.getMessage() for record in caplog.records]
    assert [line.split(": ")[0] for line in lines] == ["job job_1"] * 4
    assert [words for line in lines for words in ("full", "refused", "again") if words in line] == [
        "full", "refused", "again", "full"
    ]  # fmt: skip


@pytest.fixture
def clock(monkeypatch):
    at = [0.0]
    monkeypatch.setattr("service.jobs.outage.time.monotonic", lambda: at[0])
    return at


def test_what_is_repeated_is_told_once_in_a_minute_and_what_differs_at_once(clock):
    told, repeats = [], Repeats()

    def say(text):
        if repeats.filter(logging.LogRecord("dbos", logging.WARNING, "", 0, text, None, None)):
            told.append((clock[0], text))

    same = "Exception in the workflow {id}.1, try {at}: (sqlite3.OperationalError) full"
    for clock[0] in range(0, 130, 10):
        said = same.format(id=new_id("job"), at=clock[0])
        say(said)
        if clock[0] == 30:
            say(said.replace("full", "disk I/O error"))
    assert [(at, text.rpartition(") ")[2]) for at, text in told] == [
        (0, "full"), (30, "disk I/O error"), (60, "full"), (120, "full")
    ]  # fmt: skip
