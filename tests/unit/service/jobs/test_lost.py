"""Workflows that died: begun again by the queue that they are of, and only those that are dead."""

import logging
import threading
from types import SimpleNamespace

import pytest
from dbos import DBOS, _workflow_commands

from service.config import MOST_CPU_JOBS, Settings
from service.health import webhook
from service.jobs import engine, lost, notices
from service.jobs import worker as module
from service.jobs.engine import CPU, NOTICES, RIGS, THREADS, workflow_id
from service.jobs.lost import Watch
from service.storage import jobs, rigs, schedules
from service.storage.database import now
from service.storage.tables import ScheduleRow
from tests.support.databases import migrated
from tests.support.processes import wait_for
from tests.support.service import reference_sheet


@pytest.fixture
def worker(tmp_path, monkeypatch, request):
    """A worker with its engine in this process."""
    monkeypatch.setattr(engine, "THREADS", getattr(request, "param", THREADS))
    monkeypatch.setattr(_workflow_commands, "_BACKGROUND_JOBS_INTERVAL_SEC", 1.0)  # put back at the end
    monkeypatch.setattr(logging.getLogger("dbos"), "filters", [])
    worker = module.Worker(Settings(home=tmp_path, worker_name="w1", cpu_jobs=MOST_CPU_JOBS))
    worker.start()
    yield worker
    worker.context.dispatcher.close()
    DBOS.destroy()
    worker.context.calculator.close()
    worker.context.database.close()


@pytest.fixture
def found(tmp_path, monkeypatch):
    """What the engine believes to run here, and what it is told to do with it; none of it does."""
    believed: list[SimpleNamespace] = []
    told: list[tuple] = []
    monkeypatch.setattr(DBOS, "list_workflows", lambda **_: believed)
    monkeypatch.setattr(DBOS, "resume_workflow", lambda wanted, *, queue_name=None: told.append((wanted, queue_name)))
    monkeypatch.setattr(DBOS, "cancel_workflow", lambda wanted: told.append((wanted, "forgotten")))
    monkeypatch.setattr(lost, "waits_for_thread", lambda: False)
    with migrated("sqlite", tmp_path) as database:
        context = SimpleNamespace(database=database, settings=SimpleNamespace(worker="w1"))
        yield SimpleNamespace(believed=believed, told=told, database=database, watch=Watch(context))


def test_what_died_begins_again_within_the_limits_of_its_queue(found):
    with found.database.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
        made = {
            kind: jobs.submit(session, kind, rig, 1, "me").id for kind in ("experiment", "health", "identification")
        }
        ended = jobs.submit(session, "gap", rig, 1, "me").id
        jobs.finish(session, ended, 1, jobs.FAILED, {}, "why", "so")
    for kind, job in {**made, "gap": ended}.items():
        found.believed.append(SimpleNamespace(workflow_id=workflow_id(job, 1), name=f"ambit.{kind}"))
    found.believed.append(SimpleNamespace(workflow_id="whd_1.3", name="ambit.notice"))
    found.watch.settle()
    assert found.told == []  # on its way from the queue to its thread, it may be
    with lost.running("whd_1.3"):
        found.watch.settle()
    assert dict(found.told) == {
        f"{made['experiment']}.1": RIGS,
        f"{made['health']}.1": RIGS,
        f"{made['identification']}.1": CPU,
        f"{ended}.1": "forgotten",
    }
    found.told.clear()
    found.believed[:] = found.believed[-1:]
    for _ in range(2):
        found.watch.settle()
    assert found.told == [("whd_1.3", NOTICES)]


def messages(worker, count):
    """Messages that wait for a webhook; their ids."""
    with worker.context.database.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "", "", "me").id
        schedule = ScheduleRow(
            id="sch_1", rig_id=rig, cron="0 6 * * *", options={}, enabled=False, webhook_url="http://127.0.0.1:9/",
            webhook_secret=webhook.new_secret(), created_at=now(), updated_at=now(), created_by="me",
        )  # fmt: skip
        session.add(schedule)
        session.flush()
        made = [f"whd_{k:02}" for k in range(count)]
        for delivery_id in made:
            schedules.add_delivery(session, schedule, delivery_id, {"type": "health.missed"})
    return made


def held_up(monkeypatch):
    """Attempts that were begun, and what lets them go on."""
    begun: list[str] = []
    go_on = threading.Event()

    def attempt(delivery_id, _):
        begun.append(delivery_id)
        go_on.wait(60)

    monkeypatch.setattr(notices, "attempt", attempt)
    return begun, go_on


def statuses():
    return sorted(found.status for found in DBOS.list_workflows())


@pytest.mark.parametrize("worker", [1], indirect=True)
def test_what_waits_for_a_thread_is_not_dead_and_is_done_once(worker, monkeypatch):
    begun, go_on = held_up(monkeypatch)
    made = messages(worker, 3)
    worker._hand_over()
    wait_for(lambda: begun and statuses() == ["PENDING"] * 3, "the messages to be handed out")
    watch = Watch(worker.context)
    for _ in range(3):
        watch.settle()
        assert statuses() == ["PENDING"] * 3
    go_on.set()
    wait_for(lambda: statuses() == ["SUCCESS"] * 3, "the messages")
    assert sorted(begun) == made


def test_no_more_is_handed_out_than_there_are_threads(worker, monkeypatch):
    assert sum(DBOS.retrieve_queue(name).worker_concurrency for name in (RIGS, CPU, NOTICES)) < THREADS
    begun, go_on = held_up(monkeypatch)
    made = messages(worker, 20)
    worker._hand_over()
    wait_for(lambda: begun, "the first messages")
    Watch(worker.context).settle()
    assert statuses().count("ENQUEUED") >= 20 - engine.MOST_AT_ONCE[NOTICES]
    go_on.set()
    wait_for(lambda: statuses() == ["SUCCESS"] * 20, "the messages", 60)
    assert sorted(begun) == made
