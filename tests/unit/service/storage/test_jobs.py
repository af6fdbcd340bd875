"""Rows of jobs: who may write, what a cancel, a retry and a takeover do, on both databases."""

import pytest

from service.errors import ConflictError, NotFoundError
from service.storage import jobs, rigs
from tests.support.databases import BOTH, migrated
from tests.support.service import reference_sheet


@pytest.fixture(scope="module", params=BOTH)
def database(request, tmp_path_factory):
    with migrated(request.param, tmp_path_factory.mktemp(request.param)) as found:
        with found.write() as session:
            found.rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
        yield found


@pytest.fixture
def job(database):
    with database.write() as session:
        return jobs.submit(session, "experiment", database.rig, 1, "me").id


def now(database, job_id):
    with database.read() as session:
        return jobs.get(session, job_id)


def test_only_the_last_worker_that_began_may_write(database, job):
    with database.write() as session:
        first = jobs.claim(session, job, 1, "w1").attempt
    with database.write() as session:
        second = jobs.claim(session, job, 1, "w2").attempt
    with database.write() as session:
        assert jobs.note(session, job, first, percent=10.0)[0] is False
        assert jobs.add_journal(session, job, first, 0, b"old") is False
    with database.write() as session:
        assert jobs.note(session, job, second, percent=20.0) == (True, False)
    assert now(database, job).percent == 20.0
    assert now(database, job).worker == "w2"


def test_a_queued_job_is_cancelled_at_once_and_no_worker_begins_with_it(database, job):
    with database.write() as session:
        assert jobs.cancel(session, job).state == "cancelled"
    with database.write() as session:
        assert jobs.claim(session, job, 1, "w1") is None


def test_a_running_job_is_asked_to_end(database, job):
    with database.write() as session:
        attempt = jobs.claim(session, job, 1, "w1").attempt
    with database.write() as session:
        assert jobs.cancel(session, job).state == "running"
    with database.read() as session:
        assert jobs.note(session, job, attempt) == (True, True)
    with database.write() as session:
        assert jobs.note(session, job, attempt, percent=30.0) == (True, True)
    with database.write() as session:
        jobs.finish(session, job, 1, "cancelled", {"experiment": "exp_1"})
    with database.write() as session, pytest.raises(ConflictError, match="only what failed"):
        jobs.retry(session, jobs.submit(session, "gap", database.rig, 1, "me").id, "me")
    with database.write() as session:
        again = jobs.retry(session, job, "me")
        assert (again.state, again.run, again.cancel_requested) == ("queued", 2, False)
    with database.write() as session:
        jobs.finish(session, job, 1, "done", {})  # a late word of the first run
        assert jobs.claim(session, job, 1, "w1") is None  # and a late begin
        assert jobs.claim(session, job, 2, "w1").attempt == attempt + 1


def test_a_job_is_the_doing_of_whoever_tried_it_again(database):
    with database.write() as session:
        job = jobs.submit(session, "experiment", database.rig, 1, "laptop", key_id="key_1")
        assert (job.requested_by, job.requested_key) == ("laptop", "key_1")
        jobs.cancel(session, job.id)
    with database.write() as session:
        again = jobs.retry(session, job.id, "laptop", "key_2")  # names are not unique
        assert (again.submitted_by, again.requested_by, again.requested_key) == ("laptop", "laptop", "key_2")


def test_the_jobs_of_a_rig_are_cancelled_and_those_of_others_are_not(database, job):
    with database.write() as session:
        rig = rigs.create(session, "retired", reference_sheet(), "", "", "me").id
        waits, moves, counts, ended = (
            jobs.submit(session, kind, rig, 1, "me").id for kind in ("gap", "health", "identification", "gap")
        )
        jobs.cancel(session, ended)
    with database.write() as session:
        for each in (moves, counts):
            jobs.claim(session, each, 1, "w1")
    with database.write() as session:
        assert [found.id for found in jobs.cancel_of_rig(session, rig, "it was retired")] == sorted([waits, moves])
    waited = now(database, waits)
    assert (waited.state, waited.phase) == ("cancelled", "cancelled: it was retired")
    asked = [now(database, each).cancel_requested for each in (moves, counts, job)]
    assert asked == [True, False, False]


def test_a_running_job_that_was_asked_to_end_tells_the_first_reason_once_it_has(database, job):
    with database.write() as session:
        rig = rigs.create(session, "stopped", reference_sheet(), "", "", "me").id
        stopped, by_hand, whole = (jobs.submit(session, "experiment", rig, 1, "me").id for _ in range(3))
    with database.write() as session:
        for each in (stopped, by_hand, whole):
            jobs.claim(session, each, 1, "w1")
        jobs.cancel(session, by_hand)
        jobs.cancel_moving(session, rig, "it was stopped")
        jobs.cancel_of_rig(session, rig, "it was retired")
        for each, state in ((stopped, "cancelled"), (by_hand, "cancelled"), (whole, "done")):
            jobs.finish(session, each, 1, state, {})
    assert now(database, stopped).phase == "cancelled: it was stopped"
    assert now(database, by_hand).phase == "cancelled"
    assert (now(database, whole).phase, now(database, whole).error_detail) == ("done", "")
    with database.write() as session:
        jobs.retry(session, stopped, "me")
        jobs.claim(session, stopped, 2, "w1")
        jobs.cancel(session, stopped)
        jobs.finish(session, stopped, 2, "cancelled", {})
    assert now(database, stopped).phase == "cancelled"  # the reason was that of the run before


def test_what_has_ended_stays_ended(database, job):
    with database.write() as session:
        jobs.claim(session, job, 1, "w1")
        jobs.finish(session, job, 1, "failed", {}, "bus error", "no answer")
        jobs.finish(session, job, 1, "done", {})
    found = now(database, job)
    assert (found.state, found.error_title, found.error_detail) == ("failed", "bus error", "no answer")
    with database.write() as session, pytest.raises(ConflictError, match="failed already"):
        jobs.cancel(session, job)
    with database.write() as session, pytest.raises(NotFoundError):
        jobs.cancel(session, "job_0")


def test_a_journal_is_whole_up_to_its_first_gap(database, job):
    with database.write() as session:
        attempt = jobs.claim(session, job, 1, "w1").attempt
        for offset, part in ((0, b"abc"), (3, b"def"), (3, b"dEF"), (9, b"later")):
            assert jobs.add_journal(session, job, attempt, offset, part)
            session.flush()
    with database.read() as session:
        assert jobs.journal(session, job) == b"abcdEF"
    with database.write() as session:
        jobs.drop_journal(session, job)
        assert jobs.journal(session, job) == b""


def test_a_journal_that_is_written_anew_leaves_nothing_of_the_other_one(database, job):
    with database.write() as session:
        attempt = jobs.claim(session, job, 1, "w1").attempt
        for offset, part in ((0, b"abc"), (3, b"def"), (6, b"ghi"), (0, b"ABCDEFGHIJ"), (10, b"KL")):
            assert jobs.add_journal(session, job, attempt, offset, part)
    with database.read() as session:
        assert jobs.journal(session, job) == b"ABCDEFGHIJKL"


def test_pages_go_on_after_the_last_item_however_much_is_added(database):
    with database.write() as session:
        rig = rigs.create(session, "pages", reference_sheet(), "", "", "me").id
        made = [jobs.submit(session, "gap", rig, 1, "me").id for _ in range(5)]
    made.sort(reverse=True)
    with database.write() as session:
        first = jobs.listed(session, rig_id=rig, limit=2)
        jobs.submit(session, "gap", rig, 1, "me")
        second = jobs.listed(session, rig_id=rig, after=first.next, limit=2)
        last = jobs.listed(session, rig_id=rig, after=second.next, limit=2)
    assert [job.id for page in (first, second, last) for job in page.items] == made
    assert last.next is None
    with database.read() as session:
        assert jobs.counts(session)["queued"] >= 6


def test_jobs_that_the_engine_was_not_told_of_are_found(database, job):
    with database.write() as session:
        assert job in [found.id for found in jobs.undispatched(session)]
        jobs.dispatched(session, job, 1)
        assert job not in [found.id for found in jobs.undispatched(session)]
