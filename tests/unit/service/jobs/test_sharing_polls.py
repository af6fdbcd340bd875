"""Many workers look for work together as often as one alone: idle ones cost the database little more than one does."""

import threading
from datetime import timedelta

import pytest
from dbos import DBOS

from service.config import Settings
from service.jobs import worker as module
from service.jobs.engine import CPU, NOTICES, RIGS, poll_s
from service.storage.database import now
from service.storage.migrate import upgrade
from service.storage.tables import WorkerRow
from tests.support.processes import wait_for


class Queue:
    def __init__(self) -> None:
        self.heard: list[float] = []

    def set_polling_interval_sec(self, value: float) -> None:
        self.heard.append(value)


@pytest.fixture
def queues(monkeypatch):
    """The engine's queues, as far as they hear of an interval."""
    found = {name: Queue() for name in (RIGS, CPU, NOTICES)}
    monkeypatch.setattr(DBOS, "retrieve_queue", found.get)
    return found


@pytest.fixture
def worker(tmp_path):
    settings = Settings(home=tmp_path, worker_name="w1")
    settings.work.mkdir(parents=True)
    worker = module.Worker(settings)
    upgrade(worker.context.database)
    worker._sign_on()
    yield worker
    worker.context.database.close()


def another(worker, name: str, silent_s: float = 0.0) -> None:
    at = now() - timedelta(seconds=silent_s)
    with worker.context.database.write() as session:
        session.merge(WorkerRow(name=name, instance="x", machine="m", process=1, started_at=at, beat_at=at))


def test_the_engine_is_told_when_workers_come_and_go_and_only_then(worker, queues):
    worker._share_polls()
    assert queues[CPU].heard == []
    another(worker, "w2")
    another(worker, "dead", silent_s=60.0)
    for _ in range(3):
        worker._share_polls()
    another(worker, "w2", silent_s=60.0)
    worker._share_polls()
    for name, queue in queues.items():
        assert queue.heard == [poll_s(name, 2), poll_s(name, 1)]


@pytest.mark.parametrize("name", [RIGS, CPU, NOTICES])
def test_together_they_look_as_often_as_one_and_none_sleeps_for_long(name):
    for workers in (1, 2, 4):
        assert workers / poll_s(name, workers) == pytest.approx(1 / poll_s(name, 1))
    assert poll_s(name, 0) == poll_s(name, 1)  # one that was not counted yet looks too
    assert max(poll_s(CPU, 50), poll_s(RIGS, 50)) <= 1.0


def test_what_one_worker_can_do_for_all_is_shared_and_signs_of_life_are_not(worker, monkeypatch):
    done = {"beat": 0, "hand over": 0, "keep schedules": 0}

    def counted(name):
        def chore():
            done[name] += 1

        return chore

    for name in done:
        monkeypatch.setattr(worker, f"_{name.replace(' ', '_')}", counted(name))
    monkeypatch.setattr(worker, "_share_polls", lambda: None)
    monkeypatch.setattr(module, "BEAT_S", 0.05)
    worker._shared_by = 5
    thread = threading.Thread(target=worker.run)
    thread.start()
    try:
        wait_for(lambda: done["beat"] >= 30, "thirty signs of life")  # 1.5 s: one alone would have looked again
    finally:
        worker.context.stopping.set()
        thread.join()
    assert done["hand over"] == done["keep schedules"] == 1
