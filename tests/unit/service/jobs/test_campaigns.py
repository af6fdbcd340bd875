"""What a job on a rig tells while its controller does not do as it should."""

import threading
import time
from contextlib import ExitStack
from types import SimpleNamespace

import pytest

from drivers.errors import BusError, CancelledError, LeaseError, StoppedElsewhereError
from service import bootstrap
from service.access.audit import Action, audited
from service.access.keys import Identity, Scope
from service.campaign.aims import Profile
from service.campaign.progress import Progress
from service.campaign.run import LOCK
from service.config import Settings
from service.errors import JobError, StoppedError
from service.exclusive import sole_use
from service.jobs import campaigns
from service.storage import audit, jobs, rigs
from service.storage.database import now
from tests.support.databases import migrated
from tests.support.service import reference_sheet


class Told:
    """A control that keeps what it is told."""

    stopping = superseded = False

    def __init__(self) -> None:
        self.told = []

    def report(self, **values) -> None:
        self.told.append(values)

    def stopped(self) -> bool:
        return False

    def unheard_s(self) -> float:
        return 0.0

    def begin_journal(self, shipped: int) -> None:
        pass


@pytest.fixture
def control():
    return Told()


@pytest.fixture
def worker(tmp_path):
    with migrated("sqlite", tmp_path) as database:
        yield SimpleNamespace(database=database, settings=Settings(home=tmp_path), folder=lambda _: tmp_path)


@pytest.fixture
def job(worker):
    with worker.database.write() as session:
        rig = rigs.create(session, "bench", reference_sheet(), "modbus://127.0.0.1:9", "", "me")
        job = jobs.submit(session, "experiment", rig.id, 1, "me")
        return jobs.claim(session, job.id, 1, "w1")


@pytest.fixture
def measure(worker, job, control, monkeypatch):
    """Run the job with a controller that does nothing and a campaign that does what it is given."""

    def measure(*campaign, controller=None):
        steps = iter(campaign)
        monkeypatch.setattr(bootstrap, "connect", lambda _: controller or SimpleNamespace(close=lambda: None))
        monkeypatch.setattr(campaigns, "run_campaign", lambda *words, **more: next(steps)(*words, **more))
        return campaigns.measure(worker, job, control, Profile())

    return measure


def stopped(*_, **__):
    raise StoppedElsewhereError("the excitation was stopped by another host")


def asked_to_stop(worker, job, who):
    """What the API writes once it has stopped the rig."""
    by = Identity(key_id="key_1", name=who, scope=Scope.operator)
    with worker.database.write() as session:
        audit.record(session, audited(by, Action.rotor_released, job.rig_id, job.rig_id, how="stopped by hand"))


def test_a_stop_over_this_service_is_told_with_who_asked_for_it_and_when(worker, job, measure, monkeypatch):
    """Though it is written down only after the controller has stopped."""
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 30.0)
    later = threading.Timer(0.3, asked_to_stop, (worker, job, "tablet"))
    later.start()
    with pytest.raises(JobError, match=f"tablet stopped the rig over this service at {now():%Y-%m-%d}") as ended:
        measure(stopped)
    later.join()
    assert ended.value.title == "rig stopped"


def test_a_job_that_gave_its_lease_back_before_the_stop_was_written_down_was_stopped_all_the_same(
    worker, job, control, measure, monkeypatch
):
    """The service finds no holder any more, and cancels what it takes to wait."""
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 30.0)

    def stop():
        asked_to_stop(worker, job, "tablet")
        monkeypatch.setattr(control, "stopped", lambda: True)

    later = threading.Timer(0.3, stop)
    later.start()
    with pytest.raises(JobError, match="tablet stopped the rig over this service") as ended:
        measure(stopped)
    later.join()
    assert ended.value.title == "rig stopped"


@pytest.mark.parametrize("error", [StoppedElsewhereError("stopped"), CancelledError("stopped")])
def test_a_job_that_was_cancelled_is_cancelled_whatever_its_controller_says(control, measure, monkeypatch, error):
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 30.0)

    def cancelled(*_, **__):
        monkeypatch.setattr(control, "stopped", lambda: True)
        raise error

    with pytest.raises(StoppedError):
        measure(cancelled)


def test_a_stop_at_the_rig_is_not_told_as_one_of_an_earlier_run(worker, job, measure, monkeypatch):
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 0.0)
    asked_to_stop(worker, job, "tablet")
    time.sleep(0.01)
    job.started_at = now()
    with pytest.raises(JobError, match="by hand or by another host") as ended:
        measure(stopped)
    assert ended.value.title == "stopped at the rig"


def test_a_job_that_goes_on_waits_for_nobody_but_its_own_lease(job, control, measure, monkeypatch):
    """The one that a worker held when it was killed lapses by itself."""
    monkeypatch.setattr(campaigns, "LEASE_POLL_S", 0.0)
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 0.0)
    free = SimpleNamespace(close=lambda: None, status=lambda: SimpleNamespace(lease_holder=""))

    def held(by):
        def campaign(*_, **__):
            raise LeaseError(by, 7.2)

        return campaign

    with pytest.raises(JobError):
        measure(held(job.id), held("plc 7"), stopped, controller=free)
    assert [told["phase"] for told in control.told if told["phase"] != "connected"] == [
        "going on after a restart in 7 s",
        "waiting for the rig, which plc 7 holds for another 7 s",
    ]


@pytest.fixture
def hung(tmp_path):
    """The worker that had the job before: taken for dead, it has the job's folder yet."""
    with ExitStack() as held:
        held.enter_context(sole_use(tmp_path, "another campaign", "wait for its end", LOCK))
        yield held


def writes(_, __, folder, *___, **____):
    """A campaign that writes in its folder, until somebody stops it."""
    with sole_use(folder, "another campaign", "wait for its end", LOCK):
        stopped()


def test_a_job_waits_for_the_worker_that_it_was_taken_from_and_goes_on_when_that_lets_go(
    control, measure, hung, monkeypatch
):
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 0.0)
    monkeypatch.setattr(campaigns, "LEASE_POLL_S", 0.0)
    report = control.report

    def lets_go(**values):
        report(**values)
        if len(control.told) == 4:
            hung.close()

    monkeypatch.setattr(control, "report", lets_go)
    with pytest.raises(JobError) as ended:
        measure(writes, writes)
    assert ended.value.title == "stopped at the rig"  # only the second one came so far
    phases = [told["phase"] for told in control.told]
    assert [phase.partition(" ")[0] for phase in phases] == ["connected", "waiting", "waiting", "waiting", "connected"]
    assert "which hangs: end it" in phases[1]


def test_a_job_that_waits_for_a_worker_that_hangs_can_be_cancelled(control, measure, hung, monkeypatch):
    later = threading.Timer(0.3, monkeypatch.setattr, (control, "stopped", lambda: True))
    later.start()
    with pytest.raises(StoppedError):
        measure(writes)
    later.join()


def test_a_job_whose_controller_is_silent_says_so_while_the_point_is_tried_again(control, measure, monkeypatch):
    monkeypatch.setattr(campaigns, "STOP_NOTED_S", 0.0)

    def silent(_):
        raise BusError("no answer")

    def tries_again(controller, sheet, folder, progress, *_, **__):
        progress(Progress("main", 5, 10, 1.0, 5.0, 5.0, "main 5"))
        with pytest.raises(BusError):
            controller.measure(None)
        progress(Progress("main", 6, 10, 1.0, 4.0, 6.0, "main 6"))
        return stopped()

    with pytest.raises(JobError):
        measure(tries_again, controller=SimpleNamespace(close=lambda: None, measure=silent))
    before, waiting, after = control.told[1:]
    assert (before["phase"], after["phase"]) == ("main", "main")
    assert waiting == {"phase": "controller does not answer, waiting: no answer", "time_left_s": None}


@pytest.fixture
def connection(monkeypatch):
    """One that comes when it is let go, and whether it was given up."""
    let_go, closed = threading.Event(), threading.Event()

    def connect(_):
        let_go.wait(30)
        return SimpleNamespace(close=closed.set)

    monkeypatch.setattr(bootstrap, "connect", connect)
    yield SimpleNamespace(let_go=let_go, closed=closed)
    let_go.set()


def test_a_job_whose_driver_does_not_come_back_from_connecting_is_cancelled_all_the_same(
    worker, job, control, connection, monkeypatch
):
    later = threading.Timer(0.3, monkeypatch.setattr, (control, "stopped", lambda: True))
    later.start()
    began = time.monotonic()
    with pytest.raises(StoppedError):
        campaigns.measure(worker, job, control, Profile())
    assert time.monotonic() - began < 10
    later.join()
    connection.let_go.set()
    assert connection.closed.wait(10)  # what came late keeps no connection


def test_a_job_whose_driver_does_not_come_back_from_connecting_fails_once_the_patience_is_over(
    worker, job, control, connection, monkeypatch
):
    worker.settings = Settings(home=worker.settings.home, controller_patience_s=0.2)
    monkeypatch.setattr(campaigns, "CONNECT_S", 0.3, raising=False)
    with pytest.raises(JobError, match=r"modbus://127\.0\.0\.1:9: nothing comes") as ended:
        campaigns.measure(worker, job, control, Profile())
    assert ended.value.title == "controller does not answer"
