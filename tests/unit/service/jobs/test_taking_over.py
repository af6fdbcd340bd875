"""Whose jobs a worker takes over: those of the dead, and not of everyone when the database was away."""

import threading
import time
from datetime import timedelta

import pytest
from dbos import DBOS
from sqlalchemy.exc import OperationalError

from service.config import Settings
from service.jobs import worker as module
from service.storage.database import now
from service.storage.migrate import upgrade
from service.storage.tables import WorkerRow
from tests.support.processes import wait_for


@pytest.fixture
def asked(monkeypatch):
    """Names whose jobs the engine was asked for."""
    names: list[str] = []
    monkeypatch.setattr(DBOS, "_recover_pending_workflows", lambda silent: names.extend(silent) or [])
    return names


@pytest.fixture
def worker(tmp_path):
    """A worker without an engine, beside one that has been silent for long."""
    settings = Settings(home=tmp_path, worker_name="w1", worker_timeout_s=1.5)
    settings.work.mkdir(parents=True)
    worker = module.Worker(settings)
    upgrade(worker.context.database)
    worker._sign_on()
    with worker.context.database.write() as session:
        long_ago = now() - timedelta(minutes=1)
        session.add(WorkerRow(name="w2", instance="x", machine="m", process=1, started_at=long_ago, beat_at=long_ago))
    yield worker
    worker.context.database.close()


def run(worker) -> threading.Thread:
    thread = threading.Thread(target=worker.run)
    thread.start()
    return thread


def stop(worker, thread) -> None:
    worker.context.stopping.set()
    thread.join(20)


def test_the_jobs_of_a_silent_worker_are_taken_over(worker, asked):
    thread = run(worker)
    try:
        wait_for(lambda: "w2" in asked, "a take-over")
    finally:
        stop(worker, thread)
    assert "w1" not in asked


def test_after_an_outage_of_the_database_the_others_have_time_to_say_that_they_live(worker, asked, monkeypatch):
    away = OperationalError("SELECT", {}, Exception("the server is gone"))
    beats = iter([away])
    beat = module.Worker._beat

    def first_in_vain(self):
        for error in beats:
            raise error
        beat(self)

    monkeypatch.setattr(module.Worker, "_beat", first_in_vain)
    began = time.monotonic()
    thread = run(worker)
    try:
        wait_for(lambda: asked, "a take-over")
        assert time.monotonic() - began >= worker.settings.worker_timeout_s
    finally:
        stop(worker, thread)
