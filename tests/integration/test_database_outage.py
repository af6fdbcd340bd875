"""PostgreSQL away for some seconds: callers are told so, the rotor is left alone, and every job ends well."""

import threading
import time

import httpx
import pytest

from tests.support.postgres import Restartable
from tests.support.processes import wait_for
from tests.support.service import QUICK, reference_sheet, rig_device, service

LONG = {**QUICK, "points": 120, "rig_seconds": 240}
"""A plan that outlasts the outage."""
pytestmark = [pytest.mark.pg, pytest.mark.slow]


@pytest.fixture
def server(tmp_path):
    server = Restartable(tmp_path / "pg")
    yield server
    server.end()


@pytest.fixture
def running(server, tmp_path):
    settings = {"worker_timeout_s": 3, "lease_s": 2, "requests_per_s": 10_000}
    with service(tmp_path / "home", "given", "--no-worker", database_url=server.url, **settings) as found:
        for name in ("w1", "w2"):
            found.worker(name)
        yield found


@pytest.fixture
def rig(tmp_path):
    rig = rig_device(tmp_path)
    yield rig
    rig.device.end()


def test_a_database_that_goes_and_comes_back_costs_no_job(running, server, rig):
    rig_id = running.add_rig(reference_sheet(), rig.url)
    job_id = running.submit("experiment", rig_id, options={"profile": LONG, "identify": False})
    answers: set[tuple[int, str]] = set()
    over = threading.Event()

    def read() -> None:
        with httpx.Client(base_url=running.api.said, timeout=20) as client:
            while not over.wait(0.2):
                for path in ("/jobs", f"/jobs/{job_id}", f"/rigs/{rig_id}", "/models", "/audit"):
                    answer = client.get(f"/api/v1{path}")
                    answers.add((answer.status_code, answer.headers["content-type"]))

    reader = threading.Thread(target=read)
    reader.start()
    try:
        running.wait(job_id, lambda job: job["progress"]["point"] > 3)
        server.stop()
        assert running.client.post("/api/v1/jobs", json={"kind": "experiment", "rig": rig_id}).status_code == 503
        # nobody could cancel the job now: its rotor is at rest and its rig free until somebody can
        wait_for(lambda: not rig.status().lease_holder, "a free rig")
        assert rig.status().excitation_a == 0
        server.start()
        began = time.monotonic()
        job = running.done(job_id)
        assert time.monotonic() - began < 50
    finally:
        over.set()
        reader.join()
    assert answers == {(200, "application/json"), (503, "application/problem+json")}
    assert job["worker"] in ("w1", "w2")
    assert len([line for line in running.logs().splitlines() if "taking over" in line]) == 0
    assert running.get(f"/experiments/{job['result']['experiment']}")["complete"]
    assert not rig.status().lease_holder
    assert all(worker.process.poll() is None for worker in running.workers.values())
    running.done(running.submit("experiment", rig_id, options={"profile": QUICK, "identify": False}))
