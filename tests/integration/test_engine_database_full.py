"""The job engine cannot write down a step, as on a full disk: the job says so, the rig is free, and nothing is lost."""

import json
import sqlite3
import time
from contextlib import closing, contextmanager

import pytest

from tests.support.processes import wait_for
from tests.support.service import QUICK, reference_sheet, rig_device, service

pytestmark = pytest.mark.slow
REFUSALS = {
    "a step": "BEFORE INSERT ON operation_outputs",
    "an end": "BEFORE UPDATE OF status ON workflow_status",
}


@contextmanager
def unwritable(home, what):
    """The engine's database refuses to take something, with the class of error that a full disk has."""
    with closing(sqlite3.connect(home / "jobs.db", timeout=30)) as engine:
        engine.execute(f"CREATE TRIGGER full {REFUSALS[what]} BEGIN INSERT INTO the_disk_is_full VALUES (1); END")
        engine.commit()
        yield
        engine.execute("DROP TRIGGER full")
        engine.commit()


@pytest.fixture
def running(tmp_path):
    with service(tmp_path / "home", "sqlite", requests_per_s=10_000) as found:
        wait_for(lambda: "is ready" in found.logs(), "the worker")
        yield found


@pytest.fixture
def rig(tmp_path):
    rig = rig_device(tmp_path)
    yield rig
    rig.device.end()


def measure(running, rig_id):
    return running.submit("experiment", rig_id, options={"profile": QUICK, "identify": False})


def test_a_step_that_cannot_be_written_down_fails_its_job_which_goes_on_when_it_can(running, rig):
    rig_id = running.add_rig(reference_sheet(), rig.url)
    with unwritable(running.home, "a step"):
        job = running.wait(measure(running, rig_id))
        assert (job["state"], job["error"]["title"]) == ("failed", "job engine failed")
        assert "the_disk_is_full" in job["error"]["detail"]
        assert "see to its disk" in job["error"]["detail"]
        assert running.get(f"/experiments/{job['result']['experiment']}")["complete"]
    measured = len([event for event in rig.events() if event["text"].startswith("excitation on")])
    running.post(f"/jobs/{job['id']}/retry")
    again = running.done(job["id"])
    assert again["result"] == job["result"]
    assert len([event for event in rig.events() if event["text"].startswith("excitation on")]) == measured > 0
    running.done(measure(running, rig_id))


def test_a_workflow_whose_end_cannot_be_written_down_does_not_keep_its_rig_from_the_next_job(running, rig):
    rig_id = running.add_rig(reference_sheet(), rig.url)
    first = measure(running, rig_id)
    running.wait(first, lambda job: job["state"] == "running")
    with unwritable(running.home, "an end"):
        running.done(first)
        wait_for(lambda: "the_disk_is_full" in running.logs(), "the engine's failure")
        time.sleep(1)  # the engine does not try it again
    said = [json.loads(line) for line in running.logs().splitlines() if "disk_is_full" in line]
    assert {line["logger"] for line in said} == {"dbos"}  # in the one form of the log, and not at every look
    assert len(said) < 10
    running.done(measure(running, rig_id))


def test_a_workflow_that_was_lost_between_the_queue_and_its_thread_begins_all_the_same(running, rig):
    rig_id = running.add_rig(reference_sheet(), rig.url)
    before, lost = measure(running, rig_id), measure(running, rig_id)
    worker = running.wait(before, lambda job: job["state"] == "running")["worker"]
    with closing(sqlite3.connect(running.home / "jobs.db", timeout=30)) as engine:
        taken = "UPDATE workflow_status SET status = 'PENDING', executor_id = ? WHERE workflow_uuid = ?"
        assert engine.execute(taken, (worker, f"{lost}.1")).rowcount == 1
        engine.commit()
    running.done(before)
    running.done(lost)
