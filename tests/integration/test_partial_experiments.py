"""What a job has measured is kept as an experiment, whatever ends it and wherever that happens."""

import inspect
import threading
from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest
from dbos import DBOS

from drivers.errors import BusError, CancelledError
from service import bootstrap
from service.campaign.run import recover
from service.config import Settings
from service.errors import StoppedError
from service.experiment import file
from service.jobs import checks, notices, steps, workflows
from service.storage import jobs, results, rigs
from service.storage.blobs import Blobs
from service.storage.database import now
from service.storage.ids import derived_id
from service.storage.tables import ExperimentRow, JournalPart
from tests.support.campaigns import SMALL, Faulty, assert_same, campaign, interrupted_at
from tests.support.databases import migrated
from tests.support.service import reference_sheet

TINY = replace(SMALL, points=16, validation_points=2, amplifier_points=2)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The journal of a worker that was killed on another machine, and what it holds."""
    folder = tmp_path_factory.mktemp("killed")
    with pytest.raises(CancelledError):
        campaign(Faulty(interrupted_at(50, KeyboardInterrupt())), folder, TINY)
    return SimpleNamespace(journal=(folder / "experiment.journal").read_bytes(), experiment=recover(folder))


@pytest.fixture
def taken_over(tmp_path, monkeypatch, measured):
    """Takes over, on a machine that has nothing of it, a job whose worker has died; how the job ends."""
    monkeypatch.setattr(DBOS, "run_step", lambda _, step, *words: step(*words))
    monkeypatch.setattr(notices, "begin_failed", lambda *_: None)
    with migrated("sqlite", tmp_path) as database:
        with database.write() as session:
            rig_id = rigs.create(session, "bench", reference_sheet(), "simulated://", "", "me").id
        folder = tmp_path / "work"
        folder.mkdir()
        worker = SimpleNamespace(
            database=database,
            blobs=Blobs(str(tmp_path / "blobs")),
            settings=Settings(home=tmp_path, worker_name="w2", controller_patience_s=0.0),
            stopping=threading.Event(),
            folder=lambda _: folder,
            calculator=None,
        )
        monkeypatch.setattr(steps, "context", lambda: worker)

        def taken_over(kind, meanwhile):
            with database.write() as session:
                job_id = jobs.submit(session, kind, rig_id, 1, "me", options={"profile": asdict(TINY)}).id
                jobs.claim(session, job_id, 1, "w1")
                session.add(JournalPart(job_id=job_id, offset=0, content=measured.journal))
                meanwhile(session, job_id)
            inspect.unwrap(getattr(workflows, kind))(job_id, 1)
            with database.read() as session:
                job = jobs.get(session, job_id)
                assert jobs.journal(session, job_id) == measured.journal  # a retry goes on from there
                row = results.get(session, ExperimentRow, job.result["experiment"])
            assert row.id == derived_id("exp", job_id)
            assert not row.complete
            worker.blobs.fetch(row.file_sha256, tmp_path / "kept.h5")
            assert_same(file.read(tmp_path / "kept.h5"), measured.experiment)
            return job

        yield taken_over


def test_a_job_that_was_cancelled_while_nobody_worked_on_it(taken_over):
    assert taken_over("experiment", jobs.cancel).state == "cancelled"


def test_a_job_that_is_cancelled_before_its_check_is_planned_again(taken_over, monkeypatch):
    def stopped(*_):
        raise StoppedError("stopped while it was planned")

    monkeypatch.setattr(checks, "_baseline", stopped)
    assert taken_over("health", lambda *_: None).state == "cancelled"


def test_a_job_whose_controller_does_not_answer_any_more(taken_over, monkeypatch):
    def away(_):
        raise BusError("no route to host")

    monkeypatch.setattr(bootstrap, "connect", away)
    job = taken_over("experiment", lambda *_: None)
    assert (job.state, job.error_title) == ("failed", "controller does not answer")


def test_a_job_whose_rig_was_retired_meanwhile(taken_over):
    def retired(session, job_id):
        rigs.get(session, jobs.get(session, job_id).rig_id).retired_at = now()

    job = taken_over("experiment", retired)
    assert (job.state, job.error_title) == ("failed", "rig retired")
