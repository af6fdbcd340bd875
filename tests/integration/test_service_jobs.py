"""Jobs as a user relies on them: real API, real worker, real device over Modbus, killed for real."""

import json
import re
import shutil
import time

import pytest

from service.campaign.run import recover
from service.experiment import file
from sim.rig_file import to_toml
from tests.support.measured import small_experiment
from tests.support.processes import ROOT, wait_for
from tests.support.service import QUICK, SLOW, Running, free_port, reference_sheet, rig_device, service
from tests.support.two_axes import one_plane

DATABASES = ["sqlite", pytest.param("postgresql", marks=[pytest.mark.pg, pytest.mark.slow])]
TINY = {**QUICK, "points": 6, "validation_points": 2, "amplifier_points": 2, "rig_seconds": 15}
"""For jobs of which only the beginning and the end matter."""
on_sqlite = pytest.mark.parametrize("running", ["sqlite"], indirect=True)
"""For what no database can change."""
on_postgresql = pytest.mark.parametrize("running", [DATABASES[1]], indirect=True)
"""For what takes several machines."""


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    device = rig_device(tmp_path_factory.mktemp("rig"))
    yield device
    device.device.end()


@pytest.fixture(scope="module", params=DATABASES)
def running(request, tmp_path_factory):
    home = tmp_path_factory.mktemp(f"service-{request.param}")
    with service(home, request.param, "--no-worker", worker_timeout_s=3, lease_s=2, requests_per_s=10000) as found:
        found.worker("w1")
        yield found


@pytest.fixture
def rig_id(running, rig):
    return running.add_rig(reference_sheet(), rig.url, name=f"rig {time.time_ns()}")


@on_sqlite
def test_a_rig_is_measured_and_identified_by_one_request(running, rig, rig_id):
    job_id = running.submit("experiment", rig_id, options={"profile": QUICK})
    told = []
    with running.client.stream("GET", f"/api/v1/jobs/{job_id}/events", timeout=120) as events:
        for line in events.iter_lines():
            if line.startswith("data: "):
                told.append(json.loads(line.removeprefix("data: "))["progress"])
    percents = [p["percent"] for p in told]
    assert percents == sorted(percents)
    assert max(p["percent"] for p in told if p["phase"] in ("main", "peaks", "validation")) <= 80
    assert all(80 <= p["percent"] < 100 for p in told if p["phase"] in ("identification", "report"))
    assert any(p["time_left_s"] for p in told if p["phase"] in ("identification", "report"))
    job = running.done(job_id)
    assert job["progress"]["percent"] == 100.0
    experiment = running.get(f"/experiments/{job['result']['experiment']}")
    assert experiment["complete"]
    assert experiment["source"] == "measured"
    model = running.get(f"/models/{job['result']['model']}/result.json")
    assert model["format"] == "amb-commissioning-result"
    for plane in model["planes"].values():
        for name, truth in (("kiA", 190.0), ("kiB", 190.0)):
            assert abs(plane["stiffness"][name]["value"] / truth - 1) < 0.1
    actions = [line["action"] for line in running.get("/audit", params={"rig": rig_id})["items"]]
    assert actions == ["rotor.released", "rotor.excited", "job.submitted", "rig.created"]
    assert rig.status().excitation_a == 0


@on_sqlite
def test_what_the_readme_shows_of_the_client_runs(running, tmp_path, monkeypatch, capsys):
    block = re.search(r"```python\n(from pathlib.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert block is not None
    experiment, datasheet = one_plane(*small_experiment())
    (tmp_path / "rig.toml").write_text(to_toml(datasheet))
    (tmp_path / "out" / "rig1").mkdir(parents=True)
    file.write(tmp_path / "out" / "rig1" / "experiment.h5", experiment)
    monkeypatch.chdir(tmp_path)
    exec(block[1].replace("http://127.0.0.1:8311", running.api.said), {})
    assert "The rig 'reference' is identified" in capsys.readouterr().out


@on_sqlite
def test_a_cancelled_job_stops_the_rotor_within_a_second(running, tmp_path):
    slow = rig_device(tmp_path, "slow", "--real-time")
    try:
        rig_id = running.add_rig(reference_sheet(), slow.url, name=f"slow {time.time_ns()}")
        job_id = running.submit("experiment", rig_id, options={"profile": SLOW})
        wait_for(lambda: slow.status().excitation_a > 0, "excitation", 30)
        asked = time.monotonic()
        running.post(f"/jobs/{job_id}/cancel")
        assert running.wait(job_id)["state"] == "cancelled"
        events = slow.events()
        assert max(e["monotonic_s"] for e in events if e["text"].startswith("excitation")) - asked < 1.0
        assert events[-1]["text"] in ("stop", "lease released", "excitation off")
        assert slow.status().excitation_a == 0
    finally:
        slow.device.end()


@on_sqlite
def test_a_cancelled_job_keeps_what_was_measured_and_goes_on_with_it(running, rig, rig_id):
    job_id = running.submit("experiment", rig_id, options={"profile": SLOW, "identify": False})
    running.wait(job_id, lambda j: j["progress"]["phase"] == "main" and j["progress"]["point"] > 60)
    running.post(f"/jobs/{job_id}/cancel")
    job = running.wait(job_id)
    assert job["state"] == "cancelled"
    kept = running.get(f"/experiments/{job['result']['experiment']}")
    assert not kept["complete"]
    before = experiment_of(running, job)
    running.post(f"/jobs/{job_id}/retry")
    again = running.done(job_id)
    assert again["run"] == 2
    assert again["result"]["experiment"] == job["result"]["experiment"]
    assert running.get(f"/experiments/{job['result']['experiment']}")["complete"]
    assert_goes_on_from(before, experiment_of(running, again))


@on_sqlite
def test_a_rig_that_is_stopped_by_hand_ends_its_job_with_the_reason_and_begins_no_other(running, rig, rig_id):
    job_id, next_id = (running.submit("experiment", rig_id, options={"profile": SLOW}) for _ in range(2))
    running.wait(job_id, lambda j: j["progress"]["phase"] == "main" and j["progress"]["point"] > 40)
    assert running.get(f"/rigs/{rig_id}/status")["lease_holder"] == job_id
    assert running.client.post(f"/api/v1/rigs/{rig_id}/stop").status_code == 204
    seen = len(rig.events())
    job, waited = running.wait(job_id), running.job(next_id)
    assert job["state"] == "failed"
    assert job["error"]["title"] == "rig stopped"
    assert job["error"]["detail"].startswith("local stopped the rig over this service at ")
    assert not running.get(f"/experiments/{job['result']['experiment']}")["complete"]
    assert (waited["state"], waited["progress"]["phase"]) == ("cancelled", "cancelled: the rig was stopped by hand")
    assert rig.status().excitation_a == 0
    assert not [e for e in rig.events()[seen:] if e["text"].startswith("excitation on")]
    running.post(f"/jobs/{next_id}/retry")
    running.wait(next_id, lambda j: j["progress"]["point"] > 3)
    assert running.client.post(f"/api/v1/rigs/{rig_id}/stop").status_code == 204
    assert running.wait(next_id)["error"]["title"] == "rig stopped"  # else the next test's job hears it


def test_a_job_goes_on_from_its_last_point_after_kill_9_of_the_worker(running, rig, rig_id):
    job_id = running.submit("experiment", rig_id, options={"profile": SLOW, "identify": False})
    running.wait(job_id, lambda j: j["progress"]["point"] > 60)
    running.workers["w1"].kill()
    before = recover(running.home / "work" / job_id)
    running.workers["w1"].start()
    assert_goes_on_from(before, experiment_of(running, running.done(job_id)))
    assert rig.status().excitation_a == 0


@on_sqlite
def test_a_job_that_is_cancelled_while_its_worker_is_down_keeps_what_was_measured_and_goes_on_with_it(running, rig_id):
    job_id = running.submit("experiment", rig_id, options={"profile": SLOW, "identify": False})
    running.wait(job_id, lambda j: j["progress"]["phase"] == "main" and j["progress"]["point"] > 60)
    running.workers["w1"].kill()
    try:
        before = recover(running.home / "work" / job_id)
        running.post(f"/jobs/{job_id}/cancel")
    finally:
        running.workers["w1"].start()
    job = running.wait(job_id)
    assert job["state"] == "cancelled"
    assert not running.get(f"/experiments/{job['result']['experiment']}")["complete"]
    assert_goes_on_from(before, experiment_of(running, job))
    running.post(f"/jobs/{job_id}/retry")
    again = running.done(job_id)
    assert again["result"]["experiment"] == job["result"]["experiment"]
    assert_goes_on_from(before, experiment_of(running, again))


@on_sqlite
def test_a_stop_while_nobody_works_on_the_job_is_heard_by_who_goes_on_with_it(running, rig, rig_id):
    job_id = running.submit("experiment", rig_id, options={"profile": SLOW, "identify": False})
    running.wait(job_id, lambda j: j["progress"]["point"] > 10)
    running.workers["w1"].kill()
    try:
        assert running.client.post(f"/api/v1/rigs/{rig_id}/stop").status_code == 204
        seen = len(rig.events())
    finally:
        running.workers["w1"].start()
    job = running.wait(job_id)
    assert (job["state"], job["error"]["title"]) == ("failed", "rig stopped")
    assert not [e for e in rig.events()[seen:] if e["text"].startswith("excitation on")]


@on_postgresql
def test_a_silent_workers_job_is_taken_over_elsewhere_with_the_points_it_had(running, rig, rig_id, tmp_path):
    job_id = running.submit("experiment", rig_id, options={"profile": SLOW, "identify": False})
    running.wait(job_id, lambda j: j["progress"]["point"] > 60)
    running.workers["w1"].kill()
    shutil.copytree(running.home / "work" / job_id, tmp_path / "before")
    elsewhere = {**running.environment, "AMBIT_STORE_URL": str(running.home / "store")}
    w2 = Running(tmp_path / "w2.log", "worker", "--name", "w2", "--home", tmp_path / "w2", environment=elsewhere)
    try:
        job = running.done(job_id, s=90)
    finally:
        w2.end()
        running.workers["w1"].start()
    assert job["worker"] == "w2"
    before, after = recover(tmp_path / "before"), experiment_of(running, job)
    assert_goes_on_from(before, after, lost=15)  # what was measured in the last half second was not yet told


def test_two_jobs_on_one_rig_never_overlap(running, rig, rig_id):
    same_rig = running.add_rig(reference_sheet(), rig.url, name=f"alias {time.time_ns()}")  # only the lease can tell
    other = running.worker("w3")
    wait_for(lambda: not rig.status().lease_holder, "the lease of the killed worker to lapse")
    seen = len(rig.events())
    try:
        options = {"profile": TINY, "identify": False}
        submitted = [running.submit("experiment", r, options=options) for r in (rig_id, same_rig, rig_id)]
        for job_id in submitted:
            running.done(job_id, s=120)
    finally:
        other.end()
        del running.workers["w3"]
    holder = ""
    for event in rig.events()[seen:]:
        if event["text"].startswith("leased to"):
            assert holder == ""
            holder = event["text"]
        elif event["text"] == "lease released":
            holder = ""
    assert sum(e["text"].startswith("leased to") for e in rig.events()[seen:]) == 3


def experiment_of(running, job):
    answer = running.client.get(f"/api/v1/experiments/{job['result']['experiment']}/file")
    assert answer.status_code == 200
    path = running.home / f"{job['id']}.h5"
    path.write_bytes(answer.content)
    return file.read(path)


def assert_goes_on_from(before, after, lost=0):
    """Every point that was measured is in the end what it was; none is there twice."""
    missing = 0
    for old in before.sweeps:
        if old.kind == "noise" or old.comment == "preliminary":
            continue
        found = [y.tobytes() for y in after.named(old.comment).Y]
        assert len(found) == len(set(found))
        missing += sum(y.tobytes() not in found for y in old.Y)
    assert sum(s.n_points for s in before.sweeps) > 60
    assert missing <= lost


def test_ambit_serve_alone_goes_on_after_kill_9(tmp_path, rig):
    with service(tmp_path / "home", "sqlite", "--port", str(free_port()), lease_s=2) as found:
        rig_id = found.add_rig(reference_sheet(), rig.url)
        job_id = found.submit("experiment", rig_id, options={"profile": SLOW, "identify": False})
        found.wait(job_id, lambda j: j["progress"]["point"] > 60)
        found.api.kill()
        wait_for(lambda: not rig.status().lease_holder, "the rig to be given back by the orphaned worker", 15)
        assert rig.status().excitation_a == 0
        before = recover(found.home / "work" / job_id)
        found.api.start()
        assert_goes_on_from(before, experiment_of(found, found.done(job_id)))
