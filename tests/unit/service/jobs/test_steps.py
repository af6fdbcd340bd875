"""A step of a job tells in the log which attempt at the job it belongs to, and whose fault its end is."""

import errno
import logging
import os
import threading
import time
from types import SimpleNamespace

import pytest

from service.config import Settings
from service.errors import JobError, StoppedError
from service.jobs import context, steps
from service.storage import jobs, results, rigs
from service.storage.database import now
from service.storage.ids import derived_id
from service.storage.tables import ExperimentRow
from tests.support.databases import migrated
from tests.support.processes import wait_for
from tests.support.service import reference_sheet


@pytest.fixture
def worker(tmp_path, monkeypatch):
    with migrated("sqlite", tmp_path) as database:
        settings = Settings(home=tmp_path, worker_name="w1")
        monkeypatch.setattr(steps, "context", lambda: context.Context(settings, database, None, None, None))
        yield database


@pytest.fixture
def job(worker):
    with worker.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "", "", "me")
        return jobs.submit(session, "experiment", rig.id, 1, "me").id


def test_a_disk_that_is_full_is_told_as_that_and_not_as_a_defect(job):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/data/work/rig.toml")

    found = steps.guarded(full, job, 1)
    assert (found["state"], found["title"]) == ("failed", "error of the worker's machine")
    assert found["detail"].startswith("w1 cannot use /data/work/rig.toml: No space left on device; see")


def test_the_second_step_is_no_second_attempt_and_a_retry_is(worker, job, caplog):
    def told(run):
        caplog.clear()
        with caplog.at_level(logging.INFO):
            steps.guarded(lambda *_: {}, job, run)
        return caplog.text

    assert "attempt 1" in told(1)
    assert "attempt 1" in told(1)
    with worker.write() as session:
        jobs.finish(session, job, 1, jobs.FAILED, {})
        jobs.retry(session, job, "me", "local")
    assert "attempt 2" in told(2)


def stopped(*_):
    raise StoppedError("before its first point")


def out_of_reach(*_):
    raise JobError("controller does not answer", "before its first point")


@pytest.mark.parametrize(
    ("work", "cancelled", "state"),
    [(stopped, False, "cancelled"), (out_of_reach, False, "failed"), (out_of_reach, True, "cancelled")],
)
def test_a_retry_that_measures_nothing_leaves_the_job_what_it_has_measured_before(worker, job, work, cancelled, state):
    """Its partial experiment is in the job's result, by which whoever submitted it finds it."""
    experiment = derived_id("exp", job)
    with worker.write() as session:
        rig = jobs.get(session, job).rig_id
        of_rig = {"rig_id": rig, "rig_version": 1, "job_id": job}
        of_file = {"file_sha256": "0", "file_bytes": 1, "media_type": "", "file_name": "e.h5", "summary": {}}
        kind = {"source": "measured", "purpose": "commissioning", "complete": False}
        made = {"created_at": now(), "created_by": "me"}
        results.keep(session, ExperimentRow(id=experiment, **of_rig, **of_file, **kind, **made))
        jobs.finish(session, job, 1, jobs.FAILED, {"experiment": experiment})
        jobs.retry(session, job, "me", "local")
        jobs.get(session, job).cancel_requested = cancelled  # before a worker has begun with it
    steps.finish(job, 2, steps.guarded(work, job, 2))
    with worker.read() as session:
        found = jobs.get(session, job)
    assert (found.state, found.result) == (state, {"experiment": experiment})


class TestAnEngineThatFails:
    @pytest.fixture
    def begun(self, worker, job):
        """What becomes of a job that this worker has begun: state, title and detail once the engine has failed."""
        steps.guarded(lambda *_: {}, job, 1)

        def after(run=1, **changes):
            with worker.write() as session:
                for name, value in changes.items():
                    setattr(jobs.get(session, job), name, value)
            steps.give_up(job, run, RuntimeError("database or disk is full\nand more"))
            with worker.read() as session:
                found = jobs.get(session, job)
            return found.state, found.error_title, found.error_detail

        return after

    def test_fails_the_job_with_what_to_do(self, begun):
        state, title, detail = begun()
        assert (state, title) == ("failed", "job engine failed")
        assert detail.startswith("w1 cannot write down a step: database or disk is full; see to its disk")

    def test_ends_a_job_as_its_owner_wished(self, begun):
        assert begun(cancel_requested=True) == ("cancelled", "", "")

    def test_fails_a_job_that_it_has_not_let_begin(self, begun):
        assert begun(state="queued", worker="")[:2] == ("failed", "job engine failed")

    @pytest.mark.parametrize("changes", [{"worker": "w2"}, {"run": 0}])
    def test_leaves_a_job_alone_that_is_another_ones_now(self, begun, changes):
        assert begun(**changes)[0] == "running"


@pytest.fixture
def under_way(worker, job, monkeypatch):
    """An attempt at the job that takes its time to end once it is superseded, and what becomes of it."""
    monkeypatch.setattr(steps, "park", lambda _: None)
    order, began, may_end = [], threading.Event(), threading.Event()

    def slow(_, __, control):
        began.set()
        while not control.stopped():
            time.sleep(0.01)
        may_end.wait(30)
        order.append("the first one ended")
        raise StoppedError("superseded")

    thread = threading.Thread(target=steps.guarded, args=(slow, job, 1))
    thread.start()
    assert began.wait(30)
    yield SimpleNamespace(order=order, may_end=may_end)
    may_end.set()
    thread.join(30)


def test_a_job_that_comes_back_to_the_worker_that_has_it_waits_until_that_has_let_go(worker, job, under_way):
    """Another worker took it for dead, and gave its job back to the queue: two attempts would excite one rig."""

    def lets_go_once_the_second_one_waits():
        wait_for(lambda: phase(worker, job) == steps.EARLIER, "the second attempt waits")
        under_way.may_end.set()

    later = threading.Thread(target=lets_go_once_the_second_one_waits)
    later.start()
    found = steps.guarded(lambda *_: under_way.order.append("the second one began") or {}, job, 1)
    later.join(30)
    assert found["state"] == "done"
    assert under_way.order == ["the first one ended", "the second one began"]


def test_a_job_that_waits_for_its_earlier_attempt_can_be_cancelled(worker, job, under_way):
    def cancels_once_it_waits():
        wait_for(lambda: phase(worker, job) == steps.EARLIER, "the second attempt waits")
        with worker.write() as session:
            jobs.cancel(session, job)

    later = threading.Thread(target=cancels_once_it_waits)
    later.start()
    found = steps.guarded(lambda *_: under_way.order.append("began"), job, 1)
    later.join(30)
    assert found["state"] == "cancelled"
    assert under_way.order == []


def phase(worker, job):
    with worker.read() as session:
        return jobs.get(session, job).phase
