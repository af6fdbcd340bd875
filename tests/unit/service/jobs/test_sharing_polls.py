"""Many workers look for work together as often as one alone: idle ones cost the database little more than one does."""

import threading
from datetime import timedelta

import pytest
from dbos import DBOS, _sys_db_postgres, _workflow_commands

from service.config import Settings
from service.jobs import worker as module
from service.jobs.engine import CPU, NOTICES, RIGS, UNUSED_S, poll_s, quieten
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
    worker._beat()
    assert queues[CPU].heard == []
    another(worker, "w2")
    another(worker, "dead", silent_s=60.0)
    for _ in range(3):
        worker._beat()
    another(worker, "w2", silent_s=60.0)
    worker._beat()
    for name, queue in queues.items():
        assert queue.heard == [poll_s(name, 2), poll_s(name, 1)]


@pytest.mark.parametrize("name", [RIGS, CPU, NOTICES])
def test_together_they_look_as_often_as_one_and_none_sleeps_for_long(name):
    for workers in (1, 2, 4):
        assert workers / poll_s(name, workers) == pytest.approx(1 / poll_s(name, 1))
    assert poll_s(name, 0) == poll_s(name, 1)  # one that was not counted yet looks too
    assert poll_s(CPU, 50) <= 1.0  # the others may be at their limit: the one that is not must not sleep for long
    assert poll_s(RIGS, 50) <= 2.0  # every worker may take every rig's job


def test_what_one_worker_can_do_for_all_is_shared_and_signs_of_life_are_not(worker, monkeypatch):
    done = {"beat": 0, "hand over": 0, "keep schedules": 0}

    def counted(name):
        def chore():
            done[name] += 1

        return chore

    for name in done:
        monkeypatch.setattr(worker, f"_{name.replace(' ', '_')}", counted(name))
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


@pytest.mark.parametrize(("timeout_s", "period_s"), [(30.0, 2.0), (3.0, 1.0)])
def test_a_worker_gives_three_signs_of_life_before_the_others_take_its_jobs(tmp_path, timeout_s, period_s):
    worker = module.Worker(Settings(home=tmp_path, worker_name="w1", worker_timeout_s=timeout_s))
    assert worker.beat_s() == period_s
    worker.context.database.close()


def test_what_nobody_asks_of_the_engine_is_looked_for_seldom(tmp_path):
    """The engine has no setting for it: when its insides change, this tells that idle workers cost more again."""
    config = {"name": "ambit", "system_database_url": f"sqlite:///{tmp_path / 'jobs.db'}"}
    before = _workflow_commands._BACKGROUND_JOBS_INTERVAL_SEC
    engine = DBOS(config=config)
    try:
        quieten(engine)
        assert _workflow_commands._BACKGROUND_JOBS_INTERVAL_SEC == UNUSED_S > before
        assert engine._registry.get_internal_queue()._polling_interval_sec == UNUSED_S
        assert 1000 * UNUSED_S < _sys_db_postgres.BACKGROUND_JOB_LOCK_IDLE_TIMEOUT_MS
    finally:
        _workflow_commands._BACKGROUND_JOBS_INTERVAL_SEC = before
        DBOS.destroy()
