"""A campaign's journal in the database, from which another machine goes on."""

import threading
from types import SimpleNamespace

import pytest

from service.jobs import campaigns
from service.jobs.control import Control
from service.storage import jobs, rigs
from tests.support.databases import BOTH, migrated
from tests.support.service import reference_sheet


@pytest.fixture(params=BOTH)
def worker(request, tmp_path):
    with migrated(request.param, tmp_path) as database:
        yield SimpleNamespace(database=database, stopping=threading.Event())


@pytest.fixture
def submitted(worker):
    with worker.database.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
        return jobs.submit(session, "experiment", rig, 1, "me")


def kept(worker, job):
    with worker.database.read() as session:
        return jobs.journal(session, job.id)


def works(worker, job, path, measured):
    """A machine with a journal of its own at ``path`` takes the job and measures some more."""
    with worker.database.write() as session:
        attempt = jobs.claim(session, job.id, 1, "w1").attempt
    with Control(worker, job.id, attempt, path, period_s=60.0) as control:
        campaigns._restore_journal(worker, job, path, control)
        for piece in measured:
            with path.open("ab") as file:
                file.write(piece)
            control._turn()


def test_a_takeover_has_every_point_though_two_machines_went_different_ways(worker, submitted, tmp_path):
    works(worker, submitted, tmp_path / "one", [b"1 begun\n", b"2 by one\n", b"3 by one\n"])
    other = tmp_path / "two"
    other.write_bytes(b"1 begun\n2 by two\n3 by two\n4 by two\n")  # measured while the database was away
    works(worker, submitted, other, [b"5 by two\n"])
    assert kept(worker, submitted) == other.read_bytes()


def test_an_older_journal_takes_nothing_from_the_database(worker, submitted, tmp_path):
    works(worker, submitted, tmp_path / "one", [b"1 begun\n", b"2 by one\n", b"3 by one\n"])
    older = tmp_path / "two"
    older.write_bytes(b"1 begun\n2 by two\n")
    works(worker, submitted, older, [b"4 by two\n"])
    assert kept(worker, submitted) == older.read_bytes() == b"1 begun\n2 by one\n3 by one\n4 by two\n"
