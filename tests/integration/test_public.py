"""What needs no key is limited too: nobody keeps the service busy from outside, and watchers have an end."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import httpx
import pytest

from service.api import access, middleware, operations
from service.api.app import THREADS
from service.api.resources import events
from service.config import Settings
from service.storage import jobs
from tests.support.processes import wait_for
from tests.support.service import reference_sheet
from tests.support.serving import serving
from tests.support.uploads import good


@pytest.fixture
def service(tmp_path):
    with serving(Settings(home=tmp_path / "home", port=0)) as found:
        yield found


@pytest.fixture
def slow_to_forgive(tmp_path, monkeypatch):
    """A service that forgives a request a minute, so that no machine is too slow to ask too much of it."""
    monkeypatch.setattr(middleware, "PUBLIC", replace(middleware.PUBLIC, per_s=1 / 60, burst=20))
    with serving(Settings(home=tmp_path / "home", port=0)) as found:
        yield found


def test_an_address_that_asks_without_end_has_to_wait(slow_to_forgive):
    with httpx.Client(base_url=slow_to_forgive.url) as client:
        answers = [client.get("/web/style.css") for _ in range(middleware.PUBLIC.burst + 1)]
        assert [a.status_code for a in answers[:-1]] == [200] * middleware.PUBLIC.burst
        refused = answers[-1]
        assert (refused.status_code, refused.headers["content-type"]) == (429, "application/problem+json")
        assert int(refused.headers["retry-after"]) >= 1
        assert client.get("/healthz").status_code == 200
        assert client.get("/api/v1/rigs").status_code == 200


def test_an_address_that_asks_for_what_there_is_not_has_to_wait_as_for_what_there_is(tmp_path, monkeypatch):
    monkeypatch.setattr(access, "FAILURES", replace(access.FAILURES, per_s=1 / 60))  # no machine is too slow for that
    with serving(Settings(home=tmp_path / "home", port=0)) as service, httpx.Client(base_url=service.url) as client:
        service.key()
        for method, path in (("GET", "/api/v1/nothing"), ("PATCH", "/api/v1/jobs")):
            assert client.request(method, path).status_code == 401
        answers = [client.get("/api/nothing").status_code for _ in range(2 * access.FAILURES.burst)]
    assert answers[-1] == 429


def test_who_shows_no_key_has_nothing_read(tmp_path, monkeypatch):
    """What is no JSON, or none of the fields, is told to those who may ask: whatever the address and method."""
    monkeypatch.setattr(access, "FAILURES", replace(access.FAILURES, burst=1000))
    headers = {"content-type": "application/json"}
    with serving(Settings(home=tmp_path / "home", port=0)) as service, httpx.Client(base_url=service.url) as client:
        paths = client.get("/openapi.json").json()["paths"]
        asked = [(method, path) for path, methods in paths.items() for method in methods if path.startswith("/api/")]
        assert len(asked) > 30
        service.key()
        answers = {of: client.request(*of, content=b"{", headers=headers).status_code for of in asked}
    assert set(answers.values()) == {401}, answers


def test_metrics_and_readiness_do_not_read_the_database_for_everyone(service, monkeypatch):
    asked = []
    counts = jobs.counts
    monkeypatch.setattr(jobs, "counts", lambda session: asked.append(1) or counts(session))
    with httpx.Client(base_url=service.url) as client:
        for _ in range(20):
            assert "ambit_jobs" in client.get("/metrics").text
            assert client.get("/readyz").json()["ready"]
    assert 1 <= len(asked) <= 10


def test_a_store_that_hangs_is_told_in_time_and_keeps_no_request_waiting(service, monkeypatch):
    """However many ask: as many as there are threads for requests, and more."""
    asked_of, answered = threading.Event(), threading.Event()

    def check() -> None:
        asked_of.set()
        answered.wait(30)

    monkeypatch.setattr(service.services.blobs, "check", check)
    with httpx.Client(base_url=service.url, timeout=10) as client, ThreadPoolExecutor(THREADS + 1) as probes:
        asked = [probes.submit(client.get, "/readyz") for _ in range(THREADS + 1)]
        assert asked_of.wait(10)
        assert client.get("/api/v1/rigs").status_code == 200
        for answer in (probe.result() for probe in asked):
            assert answer.status_code == 503
            assert answer.json()["store"] == "no answer yet"
        answered.set()
        wait_for(lambda: client.get("/readyz").json()["ready"], "an answer of the store", 20)


def test_a_disk_without_room_is_not_ready(service, monkeypatch):
    monkeypatch.setattr(operations, "disk_usage", lambda _: SimpleNamespace(free=4096))
    answer = httpx.get(f"{service.url}/readyz")
    assert answer.status_code == 503
    assert "no room is left" in answer.json()["store"]


def test_methods_that_a_caller_makes_up_are_one_in_the_metrics(service):
    for method in ("BREW", "WHEN"):
        assert httpx.request(method, f"{service.url}/nowhere").status_code == 404
    text = httpx.get(f"{service.url}/metrics").text
    assert 'ambit_requests_total{method="other"' in text
    assert not [method for method in ("BREW", "WHEN") if method in text]


def test_watchers_are_counted_and_leave_room_when_they_go(service, tmp_path, monkeypatch):
    monkeypatch.setattr(events, "LARGEST", 1)
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=30) as client:
        rig = client.post("/rigs", json={"datasheet": reference_sheet()}).json()["id"]
        content = good(tmp_path / "e.h5").read_bytes()
        headers = {"content-type": "application/x-hdf5"}
        sent = client.post(f"/rigs/{rig}/experiments", content=content, headers=headers).json()["id"]
        job = client.post("/jobs", json={"kind": "gap", "rig": rig, "experiment": sent}).json()["id"]
        path = f"/jobs/{job}/events"
        with client.stream("GET", path) as first:
            lines = first.iter_lines()  # kept: a reader that is given up closes its stream
            assert next(lines)
            second = client.get(path)
            assert (second.status_code, second.headers["retry-after"]) == (429, "6")

        def served() -> bool:
            with client.stream("GET", path) as again:
                return again.status_code == 200

        wait_for(served, "room for a watcher", 20)
