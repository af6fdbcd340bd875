"""A running job hears that it is cancelled, whatever befalls its journal or one turn of its control."""

import logging
import threading
from types import SimpleNamespace

import pytest

from service.campaign.journal import line
from service.jobs.control import Control
from service.storage import jobs, rigs
from tests.support.databases import migrated
from tests.support.processes import wait_for
from tests.support.service import reference_sheet


@pytest.fixture
def worker(tmp_path):
    with migrated("sqlite", tmp_path) as database:
        yield SimpleNamespace(database=database, stopping=threading.Event())


@pytest.fixture
def job(worker):
    with worker.database.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
        job = jobs.submit(session, "experiment", rig, 1, "me")
        return jobs.claim(session, job.id, 1, "w1")


def cancel(worker, job):
    with worker.database.write() as session:
        jobs.cancel(session, job.id)


def test_a_job_whose_journal_cannot_be_opened_is_cancelled_and_keeps_its_points_once_it_can(
    worker, job, tmp_path, caplog
):
    path = tmp_path / "experiment.journal"
    path.mkdir()  # opening it is an error of the operating system, as on a disk that is away

    def kept():
        with worker.database.read() as session:
            return jobs.journal(session, job.id)

    with Control(worker, job.id, job.attempt, path, period_s=0.01) as control:
        control.begin_journal(0)
        wait_for(lambda: "cannot be read" in caplog.text, "a word of the journal")
        cancel(worker, job)
        wait_for(control.stopped, "the cancellation")
        path.rmdir()
        path.write_bytes(line({"point": 1}))
        wait_for(lambda: kept() == line({"point": 1}), "the point in the database")
    told = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert [words for text in told for words in ("cannot be read", "is read again") if words in text] == [
        "cannot be read", "is read again"
    ]  # fmt: skip


def test_a_turn_that_meets_a_defect_is_told_once_and_the_next_one_hears_of_the_cancellation(
    worker, job, monkeypatch, caplog
):
    note, failed = jobs.note, []

    def fails_at_first(*words, **values):
        if len(failed) < 3:
            failed.append(values)
            raise RuntimeError("nobody thought of this")
        return note(*words, **values)

    with Control(worker, job.id, job.attempt, period_s=0.01) as control:
        monkeypatch.setattr(jobs, "note", fails_at_first)
        cancel(worker, job)
        wait_for(control.stopped, "the cancellation")
    assert len(failed) == 3
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [RuntimeError]


def test_a_journal_that_begins_in_the_place_of_another_is_kept_from_its_first_byte(worker, job, tmp_path, monkeypatch):
    """Though the one before is on its way into the database at that moment."""
    path, add = tmp_path / "experiment.journal", jobs.add_journal
    path.write_bytes(line({"point": "of the one before"}))

    def meanwhile(*words):
        monkeypatch.setattr(jobs, "add_journal", add)
        path.write_bytes(line({"point": 1}))
        control.begin_journal(0)
        return add(*words)

    with Control(worker, job.id, job.attempt, path, period_s=60.0) as control:
        monkeypatch.setattr(jobs, "add_journal", meanwhile)
        control.begin_journal(0)
        control._turn()
    with worker.database.read() as session:
        assert jobs.journal(session, job.id) == line({"point": 1})
