"""Lists in pages, filters, the audit log, metrics, and the events of a job."""

import itertools
import json

import httpx
import pytest

from service.access.keys import Scope, id_of
from service.config import Settings
from service.storage import jobs as rows
from service.storage import keys
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ExperimentRow, HealthRow
from tests.support.api import assert_problem
from tests.support.service import reference_sheet
from tests.support.serving import serving


def test_lists_are_pages_and_filters_hold(api, rig, experiment):
    made = [
        api.post("/jobs", json={"kind": "gap", "rig": rig, "experiment": experiment}).json()["id"] for _ in range(5)
    ]
    api.post(f"/jobs/{made[0]}/cancel")
    seen, after = [], None
    while True:
        page = api.get("/jobs", params={"rig": rig, "limit": 2, **({"after": after} if after else {})}).json()
        seen += [job["id"] for job in page["items"]]
        if (after := page["next"]) is None:
            break
    assert sorted(seen) == sorted(made)
    assert seen == sorted(seen, reverse=True)
    cancelled = api.get("/jobs", params={"rig": rig, "state": "cancelled"}).json()["items"]
    assert [job["id"] for job in cancelled] == made[:1]
    assert api.post(f"/jobs/{made[0]}/retry").json()["run"] == 2


def test_alarms_are_found(api, service, rig, experiment):
    document = {"alarm": True, "zone": "B", "drifted": ["x.kiA"], "sentence": "kiA drifted", "parameters": {}}
    with service.services.database.write() as session:
        session.add(
            HealthRow(
                id=rig.replace("rig_", "hc_"), rig_id=rig, rig_version=1, experiment_id=experiment,
                model_id=rig.replace("rig_", "mod_"), document=document, report_sha256="0" * 64, alarm=True,
                created_at=now(),
            )
        )  # fmt: skip
    (found,) = api.get("/health-checks", params={"rig": rig, "alarm": True}).json()["items"]
    assert (found["zone"], found["zone_calm"], found["drifted"]) == ("B", True, ["x.kiA"])
    assert api.get("/health-checks", params={"rig": rig, "alarm": False}).json()["items"] == []
    assert api.get(f"/health-checks/{found['id']}").json()["document"] == document


def test_the_experiment_to_diagnose_is_found_among_health_checks_and_what_stopped_campaigns_kept(api, service, rig):
    made = {}
    with service.services.database.write() as session:
        for purpose, complete in itertools.product(("commissioning", "health"), (True, True, False)):
            row = ExperimentRow(
                id=new_id("exp"), rig_id=rig, rig_version=1, source="measured", purpose=purpose, complete=complete,
                file_sha256="0" * 64, file_bytes=1, media_type="", file_name="", summary={}, created_at=now(),
                created_by="test",
            )  # fmt: skip
            session.add(row)
            made.setdefault((purpose, complete), []).insert(0, row.id)

    def found(**asked) -> dict:
        return api.get("/experiments", params={"rig": rig, **asked}).json()

    for (purpose, complete), ids in made.items():
        assert [e["id"] for e in found(purpose=purpose, complete=complete)["items"]] == ids
    assert [e["id"] for e in found(purpose="health")["items"]] == made["health", False] + made["health", True]
    assert len(found(complete=True)["items"]) == 4
    newest = found(purpose="commissioning", complete=True, limit=1)
    assert [e["id"] for e in newest["items"]] == made["commissioning", True][:1]
    rest = found(purpose="commissioning", complete=True, after=newest["next"])
    assert [e["id"] for e in rest["items"]] == made["commissioning", True][1:]
    assert_problem(api.get("/experiments", params={"purpose": "check"}), 422, "purpose", "commissioning", "health")


def test_the_audit_log_tells_who_did_what(api, rig):
    job = api.post("/jobs", json={"kind": "experiment", "rig": rig}, headers={"x-request-id": "from-me"}).json()
    api.post(f"/jobs/{job['id']}/cancel")
    lines = api.get("/audit", params={"rig": rig}).json()["items"]
    assert [line["action"] for line in lines] == ["job.cancelled", "job.submitted", "rig.created"]
    assert lines[1]["request_id"] == "from-me"
    assert all(line["who"] == "local" for line in lines)


def test_operations(service):
    with httpx.Client(base_url=service.url) as client:
        assert client.get("/healthz").json() == {"alive": True}
        ready = client.get("/readyz").json()
        assert ready["ready"] is True
        assert "jobs wait" in ready["workers"]
        text = client.get("/metrics").text
    assert 'ambit_jobs{state="queued"}' in text
    assert 'ambit_requests_total{method="GET",route="/healthz",status="200"}' in text


def test_a_watcher_is_told_every_change_until_the_end(api, service, rig):
    job = api.post("/jobs", json={"kind": "experiment", "rig": rig}).json()["id"]
    events = []
    with api.stream("GET", f"/jobs/{job}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        kind = ""
        for line in stream.iter_lines():
            if line.startswith("event: "):
                kind = line[7:]
            elif line.startswith("data: "):
                events.append((kind, json.loads(line[6:])))
                with service.services.database.write() as session:
                    step = len(events)
                    if step == 1:
                        attempt = rows.claim(session, job, 1, "w1").attempt
                    elif step == 2:
                        rows.note(session, job, attempt, percent=50.0, point=3, points=6)
                    elif step == 3:
                        rows.finish(session, job, 1, "failed", {}, "bus error", "no answer")
    assert [(kind, e["state"]) for kind, e in events] == [
        ("state", "queued"),
        ("state", "running"),
        ("progress", "running"),
        ("state", "failed"),
    ]
    assert events[2][1]["progress"]["percent"] == 50.0
    assert events[3][1]["error"] == {"title": "bus error", "detail": "no answer"}


def test_a_watcher_whose_key_is_revoked_is_told_no_more(tmp_path):
    """A stream of a job that waits for hours would go on for as long."""
    with serving(Settings(home=tmp_path / "home", port=0)) as service:
        key = service.key(Scope.operator)
        shown = {"authorization": f"Bearer {key}"}
        with httpx.Client(base_url=f"{service.url}/api/v1", headers=shown, timeout=10) as api:
            body = {"datasheet": reference_sheet(), "controller_url": "modbus://127.0.0.1:9"}
            rig = api.post("/rigs", json=body).json()["id"]
            job = api.post("/jobs", json={"kind": "experiment", "rig": rig}).json()["id"]
            with api.stream("GET", f"/jobs/{job}/events") as stream:
                lines = stream.iter_lines()
                assert next(lines).startswith("id: ")
                with service.services.database.write() as session:
                    keys.revoke(session, str(id_of(key)))
                assert [line for line in lines if line.startswith("event: ")] == ["event: state"]
            assert api.get(f"/jobs/{job}/events").status_code == 401


@pytest.mark.parametrize("known", ["²", "job", "9" * 40])
def test_a_watcher_may_say_anything_of_what_it_knows(api, rig, known):
    job = api.post("/jobs", json={"kind": "experiment", "rig": rig}).json()["id"]
    api.post(f"/jobs/{job}/cancel")
    answer = api.get(f"/jobs/{job}/events", headers={"Last-Event-ID": known.encode("latin-1")})
    assert (answer.status_code, answer.text.count("event: state")) == (200, 1)
