"""The audit log names who had the rotor moved: whoever had this run of the job done."""

from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from sqlalchemy.exc import OperationalError

from drivers.errors import TripError
from service.config import Settings
from service.jobs.rotor import AuditedController
from service.storage import audit, jobs, rigs
from tests.support.databases import migrated
from tests.support.service import reference_sheet


@contextmanager
def lease(holder, seconds):
    yield


def test_a_rotor_is_moved_by_who_tried_the_job_again(tmp_path):
    with migrated("sqlite", tmp_path) as database:
        worker = SimpleNamespace(database=database, settings=Settings(home=tmp_path, worker_name="w1"))
        with database.write() as session:
            rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
            job = jobs.submit(session, "experiment", rig, 1, "laptop", key_id="key_1")
            jobs.cancel(session, job.id)
        with database.write() as session:
            again = jobs.retry(session, job.id, "tablet", "key_2")
        controller = AuditedController(SimpleNamespace(lease=lease), worker, again, lambda: False)
        with controller.lease(job.id):
            pass
        with database.read() as session:
            lines = audit.listed(session).items
    assert [line.action for line in lines] == ["rotor.released", "rotor.excited"]
    assert {(line.who, line.key_id, line.resource) for line in lines} == {("tablet", "key_2", job.id)}
    assert lines[1].detail == {"worker": "w1", "holder": job.id}


def test_a_database_that_is_away_does_not_hide_what_ended_the_lease(tmp_path):
    written = []

    def surely(change, given_up):
        written.append(change)
        if len(written) > 1:
            raise OperationalError("INSERT", {}, Exception("connection lost"))

    worker = SimpleNamespace(
        database=SimpleNamespace(surely=surely), settings=Settings(home=tmp_path, worker_name="w1")
    )
    job = SimpleNamespace(id="job_1", requested_key="key_1", requested_by="me", rig_id="rig_1")
    controller = AuditedController(SimpleNamespace(lease=lease), worker, job, lambda: True)
    with pytest.raises(TripError, match="touchdown"), controller.lease(job.id):
        raise TripError("displacement", "touchdown")
    assert len(written) == 2
