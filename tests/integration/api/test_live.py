"""A rig as it is now: its controller away, a stop by hand, a rig that nobody else sees."""

import math
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from types import SimpleNamespace
from unittest.mock import Mock

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from drivers.device.machine import RigDevice
from drivers.device.serve import ModbusOptions, RtuOptions, serve_modbus, serve_modbus_rtu
from drivers.errors import BusError, ControllerError, LimitError
from drivers.remote import RemoteController
from service import bootstrap
from service.access.audit import Action, AuditEvent
from service.access.keys import Scope
from service.api.app import THREADS
from service.api.resources import live
from service.cli.rigs import _figures
from service.client.shapes import Status
from service.config import Settings
from service.errors import ConflictError
from service.storage import audit
from service.storage import jobs as rows
from service.storage import rigs as rig_rows
from sim.reference import reference_rig
from tests.support.api import assert_problem
from tests.support.service import reference_sheet, rig_device
from tests.support.serving import serving

SHEET = reference_sheet()


def test_a_controller_that_does_not_answer_is_told_as_such(api, rig):
    status = api.get(f"/rigs/{rig}/status").json()
    assert status["reachable"] is False
    assert status["detail"]
    assert_problem(api.post(f"/rigs/{rig}/stop"), 503)


def test_a_speed_that_is_no_number_is_told_as_not_known(api, rig, capsys, monkeypatch):
    """As of a rig whose sensor of the speed is broken: the rest is told all the same, also in a terminal."""
    device = RigDevice(reference_rig(), seed=1)
    status = device.status
    monkeypatch.setattr(device, "status", lambda: replace(status(), speed_rad_s=math.nan))
    with closing(serve_modbus(device, ModbusOptions(port=0))) as served:
        changed(api, rig, served.url)
        now = api.get(f"/rigs/{rig}/status").json()
        assert (now["reachable"], now["state"], now["speed_rad_s"]) == (True, "levitated", None)
        told = dict(_figures(Status.model_validate(now), ("xA", "xB", "yA", "yB")))
        assert told["speed, rad/s"] == "–"
        assert told["excitation, A"] == "0"


def test_a_stop_of_a_controller_whose_status_cannot_be_read_has_stopped_it(api, rig, tripping, monkeypatch):
    """As of a vendor's that tells a state of its own: it took the stop."""

    def unread(controller):
        raise ControllerError("the controller tells status.state as 9")

    monkeypatch.setattr(RemoteController, "status", unread)
    changed(api, rig, tripping.url)
    assert api.post(f"/rigs/{rig}/stop").status_code == 204
    told = api.get(f"/rigs/{rig}/status").json()
    assert told["reachable"] is False
    assert "status.state as 9" in told["detail"]


def test_a_stop_that_does_not_reach_the_controller_ends_what_would_go_on_or_begin(service, api, rig, experiment):
    """The controller is away for a moment: back again, it must not find a job that knows of nothing."""
    running, waiting, calculated = (
        api.post("/jobs", json={"rig": rig, **body}).json()["id"]
        for body in ({"kind": "experiment"}, {"kind": "health"}, {"kind": "gap", "experiment": experiment})
    )
    with service.services.database.write() as session:
        rows.claim(session, running, 1, "w1")
    assert_problem(api.post(f"/rigs/{rig}/stop"), 503, "did not reach the controller", running, waiting)
    with service.services.database.read() as session:
        assert rows.get(session, running).cancel_requested
        assert rows.get(session, waiting).state == "cancelled"
        assert rows.get(session, calculated).state == "queued"
    line = api.get("/audit", params={"rig": rig}).json()["items"][0]
    assert line["action"] == "rotor.released"
    assert line["detail"]["cancelled"].split() == [running, waiting]
    with service.services.database.write() as session:
        rows.finish(session, running, 1, "cancelled", {})
    told = [api.get(f"/jobs/{job}").json() for job in (running, waiting)]
    assert [job["progress"]["phase"] for job in told] == ["cancelled: the rig was stopped by hand"] * 2
    assert [job["error"] for job in told] == [None] * 2


def test_a_rig_that_lives_inside_its_job_is_not_shown_as_another_one_and_no_stop_is_claimed(api, request):
    body = {"datasheet": SHEET, "controller_url": "Simulated://?seed=3", "name": request.node.name}
    rig = api.post("/rigs", json=body).json()["id"]
    assert_problem(api.get(f"/rigs/{rig}/status"), 409, "cancel its job", "ambit rig serve")
    assert_problem(api.post(f"/rigs/{rig}/stop"), 409, "cancel its job")
    lines = api.get("/audit", params={"rig": rig}).json()["items"]
    assert [line["action"] for line in lines] == ["rig.created"]


def changed(api, rig: str, controller_url: str) -> None:
    """Another controller from now on."""
    tag = api.get(f"/rigs/{rig}").headers["etag"]
    body = {"datasheet": SHEET, "controller_url": controller_url}
    assert api.put(f"/rigs/{rig}", json=body, headers={"if-match": tag}).status_code == 200


@pytest.fixture(scope="module")
def device(tmp_path_factory):
    device = rig_device(tmp_path_factory.mktemp("rig"))
    yield device
    device.device.end()


@pytest.mark.parametrize("now", ["", "simulated://", "modbus+rtu:///dev/nowhere", "modbus://127.0.0.1:9"])
def test_a_stop_reaches_the_controller_that_a_job_is_on_whatever_the_rig_names_by_now(service, api, rig, device, now):
    changed(api, rig, device.url)
    job = api.post("/jobs", json={"rig": rig, "kind": "experiment"}).json()["id"]
    with service.services.database.write() as session:
        rows.claim(session, job, 1, "w1")
    changed(api, rig, now)
    before = len(device.events())
    answer = api.post(f"/rigs/{rig}/stop")
    assert "stop" in [event["text"] for event in device.events()[before:]]
    with service.services.database.read() as session:
        assert rows.get(session, job).cancel_requested
    if now.startswith("modbus"):
        assert_problem(answer, 503, f"did not reach the controller {now}", job)
        assert device.url not in answer.json()["detail"]
    else:
        assert answer.status_code == 204


def test_a_stop_of_a_rig_that_lives_inside_its_job_cancels_that(service, api, request):
    body = {"datasheet": SHEET, "controller_url": "simulated://", "name": request.node.name}
    rig = api.post("/rigs", json=body).json()["id"]
    job = api.post("/jobs", json={"rig": rig, "kind": "experiment"}).json()["id"]
    with service.services.database.write() as session:
        rows.claim(session, job, 1, "w1")
    assert api.post(f"/rigs/{rig}/stop").status_code == 204
    with service.services.database.read() as session:
        assert rows.get(session, job).cancel_requested


@pytest.fixture
def tripping():
    """A controller that a test can trip."""
    with closing(serve_modbus(RigDevice(reference_rig(), seed=1), ModbusOptions(port=0))) as served:
        yield served


def test_a_stop_that_cannot_be_written_down_is_said_to_have_reached_the_controller(api, rig, tripping, monkeypatch):
    full = OperationalError("UPDATE", {}, sqlite3.OperationalError("database or disk is full"))
    monkeypatch.setattr(live.jobs, "cancel_moving", Mock(side_effect=full))
    changed(api, rig, tripping.url)
    told = api.post(f"/rigs/{rig}/stop")
    assert_problem(told, 503, f"the excitation was ended at {tripping.url}", "jobs that wait may move the rotor again")


def test_a_stop_that_the_controller_refuses_is_not_said_to_have_stopped_anything(api, rig, tripping, monkeypatch):
    def refuse(token: int = 0) -> None:
        raise LimitError("not now")

    changed(api, rig, tripping.url)
    with monkeypatch.context() as patch:
        patch.setattr(tripping.device, "stop", refuse)
        assert_problem(api.post(f"/rigs/{rig}/stop"), 503, "refused to stop")
    line = api.get("/audit", params={"rig": rig}).json()["items"][0]
    assert line["detail"]["how"] == "stop asked for by hand; the controller did not confirm it"


def test_who_looks_at_a_rig_on_a_serial_line_leaves_the_line_to_its_jobs():
    """A port is open for one process at a time."""
    with closing(serve_modbus_rtu(RigDevice(reference_rig(), seed=1), RtuOptions())) as served:
        line = live._Line(served.url)
        assert line.status().reachable
        with closing(bootstrap.connect(served.url)) as of_a_job:
            assert of_a_job.status().state.name == "LEVITATED"
        assert line.status().reachable
        line.close()


def test_a_latched_trip_is_acknowledged_by_whoever_says_so_and_that_is_kept(api, rig, tripping):
    changed(api, rig, tripping.url)
    assert api.post(f"/rigs/{rig}/acknowledge").json() == {"acknowledged": None, "state": "levitated"}
    tripping.device.fault("sensor supply lost")
    assert api.get(f"/rigs/{rig}/status").json()["state"] == "tripped"
    done = api.post(f"/rigs/{rig}/acknowledge").json()
    assert "sensor supply lost" in done["acknowledged"]
    assert done["state"] == api.get(f"/rigs/{rig}/status").json()["state"] == "levitated"
    told = [line for line in api.get("/audit", params={"rig": rig}).json()["items"] if line["action"][:4] == "trip"]
    assert [line["action"] for line in told] == ["trip.acknowledged"]
    assert "sensor supply lost" in told[0]["detail"]["trip"]


def test_the_trip_of_a_rig_that_somebody_holds_is_left_to_them(api, rig, tripping):
    changed(api, rig, tripping.url)
    tripping.device.fault("sensor supply lost")
    with bootstrap.connected(tripping.url) as controller, controller.lease("bench 7"):
        assert_problem(api.post(f"/rigs/{rig}/acknowledge"), 409, "bench 7")
    assert api.get(f"/rigs/{rig}/status").json()["state"] == "tripped"


def test_no_trip_is_acknowledged_where_nobody_answers(api, rig, request):
    assert_problem(api.post(f"/rigs/{rig}/acknowledge"), 503)
    body = {"datasheet": SHEET, "controller_url": "simulated://", "name": f"{request.node.name}, inside"}
    inside = api.post("/rigs", json=body).json()["id"]
    assert_problem(api.post(f"/rigs/{inside}/acknowledge"), 409, "ambit rig serve")


def test_a_driver_with_a_defect_does_not_keep_the_jobs_from_their_end(service, api, rig, monkeypatch):
    """Nor is the stop said to have reached the rotor."""
    job = api.post("/jobs", json={"rig": rig, "kind": "experiment"}).json()["id"]
    monkeypatch.setattr(bootstrap, "connect", lambda url: 1 // 0)
    assert_problem(api.post(f"/rigs/{rig}/stop"), 503, "ZeroDivisionError", job)
    with service.services.database.read() as session:
        assert rows.get(session, job).state == "cancelled"


def test_a_stop_waits_for_no_other_request(tmp_path, monkeypatch):
    """Not even with a key that was never shown before."""
    waiting, let_go = threading.Semaphore(0), threading.Event()

    def hang(*_, **__):
        waiting.release()
        let_go.wait(30)
        raise ConflictError("it took too long")

    monkeypatch.setattr(rig_rows, "listed", hang)
    with (
        serving(Settings(home=tmp_path / "home", port=0, requests_per_s=10_000)) as service,
        httpx.Client(base_url=f"{service.url}/api/v1", timeout=40) as api,
        ThreadPoolExecutor(THREADS) as lookers,
    ):
        keys = [{"authorization": f"Bearer {service.key(Scope.operator)}"} for _ in range(2)]
        body = {"datasheet": SHEET, "controller_url": "modbus://127.0.0.1:9"}
        rig = api.post("/rigs", json=body, headers=keys[0]).json()["id"]
        looks = [lookers.submit(api.get, "/rigs", headers=keys[0]) for _ in range(THREADS)]
        try:
            assert all(waiting.acquire(timeout=10) for _ in looks)
            answer = api.post(f"/rigs/{rig}/stop", headers=keys[1], timeout=10)
            assert_problem(answer, 503, "did not reach the controller")
        finally:
            let_go.set()
        assert {look.result().status_code for look in looks} == {409}


@pytest.fixture
def hanging(api, rig, monkeypatch):
    """A rig whose controller's driver comes back from nothing, and how often it was asked."""
    url, let_go, asked = "modbus://127.0.0.1:10", threading.Event(), []
    changed(api, rig, url)
    connect = bootstrap.connect

    def hang(to: str):
        if to != url:
            return connect(to)
        asked.append(to)
        let_go.wait(60)
        raise BusError("let go")

    monkeypatch.setattr(bootstrap, "connect", hang)
    monkeypatch.setattr(live, "ANSWER_S", 1.0)
    yield rig, asked
    let_go.set()


def test_a_controller_that_hangs_has_each_request_answered_in_time(api, hanging):
    rig, _ = hanging
    unknown = api.post(f"/rigs/{rig}/acknowledge", timeout=10)
    assert_problem(unknown, 503, "does not answer within 1 s", "whether its trip is acknowledged is not known")
    for _ in range(2):
        status = api.get(f"/rigs/{rig}/status", timeout=10).json()
        assert status["reachable"] is False
        assert status["detail"].startswith("modbus://127.0.0.1:10: what it was asked before is not answered yet")
        assert_problem(api.post(f"/rigs/{rig}/stop", timeout=10), 503, "did not reach", "no answer within 1 s")


def test_however_many_ask_for_a_controller_that_hangs_other_rigs_and_jobs_are_served(api, hanging, tripping, request):
    rig, asked = hanging
    body = {"datasheet": SHEET, "controller_url": tripping.url, "name": f"{request.node.name}, another"}
    other = api.post("/rigs", json=body).json()["id"]
    own = httpx.Limits(max_connections=None, max_keepalive_connections=0)  # threads that share connections lose some
    with httpx.Client(base_url=api.base_url, timeout=30, limits=own) as many, ThreadPoolExecutor(135) as lookers:
        ways = [(many.get, "status"), (many.post, "stop"), (many.post, "acknowledge")] * 45
        looks = [lookers.submit(way, f"/rigs/{rig}/{what}") for way, what in ways]
        while len(asked) < 2:
            time.sleep(0.01)
        began = time.monotonic()
        assert api.get("/jobs").status_code == 200
        assert api.get(f"/rigs/{other}/status").json()["reachable"] is True
        assert api.post(f"/rigs/{other}/stop").status_code == 204
        assert time.monotonic() - began < 5
        assert {look.result().status_code for look in looks} == {200, 503}
    assert len(asked) <= 2 + live.STOPS_EACH


@pytest.mark.parametrize("began", ["before the stop", "after it"])
def test_a_stop_leaves_a_job_to_its_controller_only_if_its_lease_began_before(service, api, rig, tripping, began):
    """One that leased the rig right after the stop is named as its holder, too, but has heard of nothing."""
    changed(api, rig, tripping.url)
    job = api.post("/jobs", json={"rig": rig, "kind": "experiment"}).json()["id"]
    earlier = [AuditEvent(action, "", "", job, rig) for action in (Action.rotor_excited, Action.rotor_released)]
    with service.services.database.write() as session:
        rows.claim(session, job, 1, "w1")
        for event in (*earlier, *earlier[: began == "before the stop"]):  # no rotor moves before it is written down
            audit.record(session, replace(event, at=datetime.now(UTC)))
    with bootstrap.connected(tripping.url) as controller, controller.lease(job):
        assert api.post(f"/rigs/{rig}/stop").status_code == 204
    with service.services.database.read() as session:
        assert rows.get(session, job).cancel_requested is (began == "after it")


def test_stops_of_one_rig_that_come_together_all_reach_it(api, rig, tripping):
    changed(api, rig, tripping.url)
    with httpx.Client(base_url=api.base_url, timeout=30) as many, ThreadPoolExecutor(40) as callers:
        stops = [callers.submit(many.post, f"/rigs/{rig}/stop") for _ in range(40)]
        assert {stop.result().status_code for stop in stops} == {204}


def test_a_stop_is_answered_by_one_that_began_after_it_was_asked_for(monkeypatch):
    """Of many that come together, over a bus that takes its time, none is refused for those before it."""
    reached = []

    class Slow:
        def stop(self):
            reached.append(time.monotonic())
            time.sleep(0.3)

        def status(self):
            return SimpleNamespace(lease_holder="a campaign")

    monkeypatch.setattr(live, "ANSWER_S", 2.0)  # 40 in turns of four would take 3 s, and may wait for one
    line, asked = live._Line("modbus://slow"), []
    line.controller = Slow()

    def stop(_):
        asked.append(time.monotonic())
        return line.stop()

    with ThreadPoolExecutor(40) as callers:
        assert set(callers.map(stop, range(40))) == {"a campaign"}
    assert max(reached) > max(asked), "a stop began after the last was asked for"
    before = len(reached)
    assert line.stop() == "a campaign"
    assert len(reached) == before + 1, "none that began before it was asked for answers it"


def test_a_stop_that_failed_answers_no_other(monkeypatch):
    line, tried = live._Line("modbus://away"), []

    @contextmanager
    def refuse(url):
        tried.append(url)
        time.sleep(0.1)
        raise BusError("nobody answers")
        yield

    monkeypatch.setattr(bootstrap, "connected", refuse)

    def stop(_):
        with pytest.raises(BusError, match="nobody answers"):
            line.stop()

    with ThreadPoolExecutor(8) as callers:
        list(callers.map(stop, range(8)))
    assert len(tried) == 8
