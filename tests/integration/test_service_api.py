"""The API as its callers rely on it: idempotency, ETags, pages, problems, schedules; a real socket, no worker."""

import json
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta

import httpx
import pytest
from sqlalchemy import select

from service.config import Settings
from service.jobs import timetable
from service.storage import jobs as rows
from service.storage.database import now
from service.storage.tables import ExperimentRow, HealthRow, JobRow, ModelRow, ScheduleRow, ScheduleRunRow, WebhookRow
from tests.support.service import reference_sheet
from tests.support.serving import serving
from tests.support.uploads import good

SHEET = reference_sheet()


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    home, address = tmp_path_factory.mktemp("home"), "https://rotor.example.org/"
    with serving(Settings(home=home, port=0, requests_per_s=10_000, public_url=address)) as found:
        yield found


@pytest.fixture(scope="module")
def api(service):
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=30) as client:
        yield client


@pytest.fixture
def rig(api, request):
    body = {"datasheet": SHEET, "controller_url": "modbus://127.0.0.1:9", "name": request.node.name[:200]}
    return api.post("/rigs", json=body).json()["id"]


@pytest.fixture
def experiment(service, rig):
    """Of this rig; its file does not matter here."""
    return commissioned(service, rig)


def commissioned(service, rig):
    """The experiment of a rig that has been commissioned."""
    with service.services.database.write() as session:
        row = ExperimentRow(
            id=rig.replace("rig_", "exp_"), rig_id=rig, rig_version=1, source="measured", purpose="commissioning",
            complete=True, file_sha256="0" * 64, file_bytes=1, media_type="application/x-hdf5", file_name="e.h5",
            summary={}, created_at=now(), created_by="test",
        )  # fmt: skip
        session.add(row)
        session.flush()
        session.add(
            ModelRow(
                id=rig.replace("rig_", "mod_"), rig_id=rig, rig_version=1, experiment_id=row.id,
                result_sha256="0" * 64, report_sha256="0" * 64, plots_sha256="0" * 64,
                summary={"planes": {"x": {"stiffness": {"kiA": {"value": 181.0}}, "modes": []}}},
                created_at=now(), created_by="test",
            )
        )  # fmt: skip
    return row.id


def is_problem(answer, status, *words):
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["status"] == status
    assert body["request_id"] == answer.headers["x-request-id"]
    for word in words:
        assert word in body["detail"]


# ---- doing things once


def test_the_same_request_under_a_key_is_done_once(api, service, rig, experiment):
    body = {"kind": "identification", "rig": rig, "experiment": experiment}
    headers = {"Idempotency-Key": f"once {rig}"}
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: api.post("/jobs", json=body, headers=headers), range(8)))
    assert {a.status_code for a in answers} == {202}
    assert len({a.json()["id"] for a in answers}) == 1
    assert len({a.headers["location"] for a in answers}) == 1
    assert sum("idempotent-replayed" not in a.headers for a in answers) == 1
    with service.services.database.read() as session:
        assert len(list(session.scalars(select(JobRow).where(JobRow.rig_id == rig)))) == 1
    is_problem(api.post("/jobs", json={**body, "priority": 1}, headers=headers), 422, "another request")


def test_a_retry_that_is_sent_again_is_done_once(api, service, rig, experiment):
    job = api.post("/jobs", json={"kind": "gap", "rig": rig, "experiment": experiment}).json()["id"]
    api.post(f"/jobs/{job}/cancel")
    headers = {"Idempotency-Key": f"retry {rig}"}
    first, second = (api.post(f"/jobs/{job}/retry", headers=headers) for _ in range(2))
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json() == second.json()
    assert "idempotent-replayed" in second.headers
    assert api.get(f"/jobs/{job}").json()["run"] == 2
    is_problem(api.post(f"/jobs/{job}/retry"), 409, "only what failed")


def test_a_refused_request_may_be_sent_again_under_its_key(api, service, rig):
    """A refusal is not remembered: what stood in its way is removed, and the same request is done."""
    headers = {"Idempotency-Key": f"refused {rig}"}
    body = {"kind": "health", "rig": rig}
    is_problem(api.post("/jobs", json=body, headers=headers), 404, "commission it first")
    commissioned(service, rig)
    answer = api.post("/jobs", json=body, headers=headers)
    assert (answer.status_code, answer.json()["kind"]) == (202, "health"), answer.text
    assert "idempotent-replayed" not in answer.headers


def test_an_upload_that_is_sent_again_is_kept_once(api, rig, tmp_path):
    content = good(tmp_path / "e.h5").read_bytes()
    headers = {"content-type": "application/x-hdf5", "Idempotency-Key": f"upload {rig}"}
    first, second = (api.post(f"/rigs/{rig}/experiments", content=content, headers=headers) for _ in range(2))
    assert first.status_code == second.status_code == 201, first.text
    assert first.json() == second.json()
    other = good(tmp_path / "f.h5", points=9).read_bytes()
    is_problem(api.post(f"/rigs/{rig}/experiments", content=other, headers=headers), 422, "another request")
    assert len(api.get("/experiments", params={"rig": rig}).json()["items"]) == 1


# ---- versions and ETags


def test_only_who_has_read_the_newest_version_changes_a_rig(api, rig):
    read = api.get(f"/rigs/{rig}")
    assert api.get(f"/rigs/{rig}", headers={"If-None-Match": read.headers["etag"]}).status_code == 304
    body = {"datasheet": SHEET, "controller_url": "modbus://127.0.0.1:10", "note": "moved"}
    is_problem(api.put(f"/rigs/{rig}", json=body), 428, read.headers["etag"])
    changed = api.put(f"/rigs/{rig}", json=body, headers={"If-Match": read.headers["etag"]})
    assert (changed.status_code, changed.json()["version"]) == (200, 2)
    is_problem(api.put(f"/rigs/{rig}", json=body, headers={"If-Match": read.headers["etag"]}), 412)
    assert [v["version"] for v in api.get(f"/rigs/{rig}/versions").json()["items"]] == [2, 1]
    assert api.get(f"/rigs/{rig}", params={"version": 1}).json()["controller_url"] == "modbus://127.0.0.1:9"
    is_problem(api.get(f"/rigs/{rig}", params={"version": 7}), 404, "1 to 2")


def test_a_job_keeps_the_version_that_it_was_submitted_for(api, rig):
    job = api.post("/jobs", json={"kind": "experiment", "rig": rig}).json()
    tag = api.get(f"/rigs/{rig}").headers["etag"]
    api.put(f"/rigs/{rig}", json={"datasheet": SHEET, "note": "later"}, headers={"If-Match": tag})
    assert api.get(f"/jobs/{job['id']}").json()["rig_version"] == 1


def test_a_retired_rig_takes_no_jobs_and_keeps_its_history(api, rig):
    assert api.delete(f"/rigs/{rig}").status_code == 204
    is_problem(api.post("/jobs", json={"kind": "experiment", "rig": rig}), 409, "retired")
    assert api.get(f"/rigs/{rig}").json()["retired_at"] is not None
    assert rig not in [r["id"] for r in api.get("/rigs", params={"limit": 1000}).json()["items"]]


def test_what_is_under_way_on_a_rig_ends_when_it_is_retired_and_is_not_tried_again(api, service, rig, experiment):
    waits, moves, counts = (
        api.post("/jobs", json={"rig": rig, "priority": k + 1, **body}).json()["id"]
        for k, body in enumerate(
            [{"kind": "experiment"}, {"kind": "health"}, {"kind": "gap", "experiment": experiment}]
        )
    )
    with service.services.database.write() as session:
        for job in (moves, counts):
            rows.claim(session, job, 1, "w1")
    assert api.delete(f"/rigs/{rig}").status_code == 204
    waited, moved, counted = (api.get(f"/jobs/{job}").json() for job in (waits, moves, counts))
    assert (waited["state"], waited["progress"]["phase"]) == ("cancelled", "cancelled: the rig was retired")
    assert (moved["state"], moved["cancel_requested"]) == ("running", True)
    assert (counted["state"], counted["cancel_requested"]) == ("running", False)
    cancelled = api.get("/audit", params={"rig": rig, "action": "job.cancelled"}).json()["items"]
    assert {(line["subject"], line["detail"]["why"]) for line in cancelled} == {
        (job, "the rig was retired") for job in (waits, moves)
    }
    is_problem(api.post(f"/jobs/{waits}/retry"), 409, "retired")
    assert api.get(f"/jobs/{waits}").json()["state"] == "cancelled"


# ---- what is refused


@pytest.mark.parametrize(
    ("body", "status", "word"),
    [
        ({"kind": "identification"}, 422, "give the field experiment"),
        ({"kind": "experiment", "experiment": "exp_1"}, 422, "leave the field experiment out"),
        ({"kind": "experiment", "options": {"profile": {"points": 0}}}, 422, "points"),
        ({"kind": "experiment", "options": {"speed": 1}}, 422, "speed"),
        ({"kind": "experiment", "options": {"excitation": "chirp"}}, 422, "options.excitation"),
        ({"kind": "experiment", "options": {"excitation": "multisine", "profile": {"points": 9}}}, 422, "points"),
        ({"kind": "experiment", "options": {"profile": {"realisations": 4}}}, 422, "realisations"),
        ({"kind": "gap", "experiment": "exp_1"}, 404, "exp_1"),
        ({"kind": "magic"}, 422, "kind"),
        ({"kind": "experiment", "priority": 0}, 422, "priority"),
    ],
)
def test_a_job_that_cannot_be_done_is_refused_at_once(api, rig, body, status, word):
    is_problem(api.post("/jobs", json={"rig": rig, **body}), status, word)


@pytest.mark.parametrize(
    ("url", "word"),
    [
        ("ftp://host", "begins with one of"),
        ("replay:///etc/passwd", "begins with one of"),
        ("modbus://host:1?transcript=/tmp/x", "transcript"),
        ("modbuss://host:1?ca=/etc/ssl/key.pem", "controllers"),
        ("simulated://?rig=/etc/passwd", "controllers"),
        ("modbus://", "names no host"),
    ],
)
def test_a_controllers_url_reaches_no_file_of_the_service(api, url, word):
    is_problem(api.post("/rigs", json={"datasheet": SHEET, "controller_url": url, "name": "x"}), 422, word)


def test_requests_that_are_no_requests(api):
    is_problem(api.get("/nothing"), 404, "/openapi.json")
    is_problem(api.patch("/jobs"), 405, "PATCH", "/openapi.json")
    is_problem(api.post("/jobs", content=b"{", headers={"content-type": "application/json"}), 422, "JSON")
    is_problem(api.post("/rigs", content=b"x" * 2_000_000), 413, "1,000,000")
    is_problem(api.post("/rigs", content=iter([b"x" * 600_000] * 3)), 413, "1,000,000")
    is_problem(api.get("/jobs", params={"after": "';--"}), 422, "after")


# ---- lists


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


def test_histories_are_of_the_rig(api, rig, experiment):
    found = api.get(f"/rigs/{rig}/stiffness").json()["items"]
    assert [entry["planes"]["x"]["kiA"]["value"] for entry in found] == [181.0]
    assert api.get(f"/rigs/{rig}/trend").json() == {"rig": rig, "checks": [], "next": None, "series": {}}


# ---- schedules


def test_a_schedule_is_kept_by_the_clock_and_misses_are_told(api, service, rig, experiment):
    body = {"rig": rig, "cron": "0 6 * * *", "webhook": {"url": "https://plant.example/hook"}}
    made = api.post("/schedules", json=body).json()
    assert made["webhook"]["secret"].startswith("whsec_")
    read = api.get(f"/schedules/{made['id']}")
    assert read.json()["webhook"]["secret"] is None  # shown once
    database, settings = service.services.database, service.services.settings
    with database.write() as session:
        row = session.get(ScheduleRow, made["id"])
        first = row.next_at = row.next_at - timedelta(days=3)
    assert timetable.keep(database, settings, first + timedelta(days=2, minutes=1)) == 1
    assert timetable.keep(database, settings, first + timedelta(days=2, minutes=2)) == 0  # another worker, or again
    runs = api.get(f"/schedules/{made['id']}/runs").json()["items"]
    assert [run["state"] for run in runs] == ["submitted", "missed", "missed"]
    job = api.get(f"/jobs/{runs[0]['job']}").json()
    assert (job["kind"], job["schedule"]) == ("health", made["id"])
    (line,) = api.get("/audit", params={"subject": job["id"]}).json()["items"]
    assert (line["action"], line["key"], line["rig"]) == ("job.submitted", f"schedule:{made['id']}", rig)
    assert timetable.keep(database, settings, first + timedelta(days=3, hours=1)) == 0  # too late to begin
    assert api.get(f"/schedules/{made['id']}/runs").json()["items"][0]["state"] == "missed"
    changed = {**body, "cron": "0 7 * * *"}
    is_problem(api.put(f"/schedules/{made['id']}", json=changed), 428)
    answer = api.put(f"/schedules/{made['id']}", json=changed, headers={"If-Match": read.headers["etag"]})
    assert (answer.status_code, answer.json()["webhook"]["secret"]) == (200, None)
    assert api.delete(f"/schedules/{made['id']}").status_code == 204
    is_problem(api.get(f"/schedules/{made['id']}"), 404)


def test_messages_that_wait_for_a_webhook_end_with_it(api, service, rig):
    body = {"rig": rig, "cron": "0 6 * * *", "webhook": {"url": "https://plant.example/hook"}}
    made = api.post("/schedules", json=body).json()
    with service.services.database.write() as session:
        common = {"schedule_id": made["id"], "health_id": "hc_1", "url": "u", "created_at": now(), "updated_at": now()}
        session.add_all(WebhookRow(id=f"{rig}{state}"[4:], state=state, **common) for state in ("pending", "delivered"))
    tag = api.get(f"/schedules/{made['id']}").headers["etag"]
    without = {**body, "webhook": None}
    assert api.put(f"/schedules/{made['id']}", json=without, headers={"If-Match": tag}).status_code == 200
    with service.services.database.read() as session:
        found = session.scalars(select(WebhookRow).where(WebhookRow.schedule_id == made["id"]))
        assert {(d.id[26:], d.state, d.detail) for d in found} == {
            ("pending", "failed", "the webhook was removed"),
            ("delivered", "delivered", ""),
        }
    api.delete(f"/schedules/{made['id']}")


def messages(service, schedule):
    """What the webhook of a schedule is told, oldest first."""
    with service.services.database.read() as session:
        query = select(WebhookRow).where(WebhookRow.schedule_id == schedule).order_by(WebhookRow.created_at)
        return [(row.contents["type"], row.contents["data"]) for row in session.scalars(query)]


def test_checks_that_were_not_made_are_told(api, service, rig, experiment):
    database, settings = service.services.database, service.services.settings
    hook = {"url": "https://plant.example/hook", "on": "alarm"}
    made = api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *", "webhook": hook}).json()["id"]
    day = timedelta(days=1)
    with database.write() as session:
        row = session.get(ScheduleRow, made)
        first = row.next_at = row.next_at - 9 * day
    assert timetable.keep(database, settings, first + 2 * day) == 1  # back after two missed
    ((kind, told),) = messages(service, made)
    assert (kind, told["missed"], told["due_at"]) == ("health.missed", 2, f"{first + day:%Y-%m-%dT%H:%M:%SZ}")
    assert "the service was down" in told["sentence"]
    assert told["url"] == f"https://rotor.example.org/api/v1/schedules/{made}/runs"

    # the rig is held by another host: what waits is told of once, and nothing piles up behind it
    job = api.get("/jobs", params={"rig": rig}).json()["items"][0]["id"]
    with database.write() as session:
        attempt = rows.claim(session, job, 1, "w1").attempt
        rows.note(session, job, attempt, phase="waiting for the rig, which plc 7 holds")
    assert [timetable.keep(database, settings, first + k * day) for k in (3, 4, 5)] == [0, 0, 0]
    with database.read() as session:
        runs = session.scalars(select(ScheduleRunRow).where(ScheduleRunRow.schedule_id == made))
        assert [run.state for run in runs if "plc 7" in run.detail and job in run.detail] == ["missed"] * 3
    assert len(api.get("/jobs", params={"rig": rig}).json()["items"]) == 1
    (kind, told), *_ = messages(service, made)[1:]
    assert (kind, len(messages(service, made))) == ("health.missed", 2)
    assert "plc 7" in told["sentence"]

    # it ends, and the next check is made; one that is refused is told, too
    with database.write() as session:
        rows.finish(session, job, 1, "cancelled", {})
    assert timetable.keep(database, settings, first + 6 * day) == 1
    api.post(f"/jobs/{api.get('/jobs', params={'rig': rig}).json()['items'][0]['id']}/cancel")
    with database.write() as session:
        session.delete(session.get(ModelRow, rig.replace("rig_", "mod_")))
    assert timetable.keep(database, settings, first + 7 * day) == 0
    kind, told = messages(service, made)[-1]
    assert (kind, "commission it first" in told["sentence"]) == ("health.missed", True)
    api.delete(f"/schedules/{made}")


def test_a_retired_rig_is_checked_no_more_and_nobody_is_told_of_it(api, service, rig, experiment):
    made = api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *"}).json()
    api.delete(f"/rigs/{rig}")
    read = api.get(f"/schedules/{made['id']}").json()
    assert (read["enabled"], read["next_at"]) == (False, None)
    with service.services.database.read() as session:
        due = session.get(ScheduleRow, made["id"]).next_at
    assert timetable.keep(service.services.database, service.services.settings, due + timedelta(seconds=1)) == 0
    assert messages(service, made["id"]) == []


def test_a_schedule_of_a_rig_that_cannot_be_checked_says_so(api, service, rig):
    made = api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *"}).json()
    with service.services.database.read() as session:
        due = session.get(ScheduleRow, made["id"]).next_at
    assert timetable.keep(service.services.database, service.services.settings, due + timedelta(seconds=1)) == 0
    (run,) = api.get(f"/schedules/{made['id']}/runs").json()["items"]
    assert run["state"] == "refused"
    assert "commission it first" in run["detail"]


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"cron": "every day"}, "five fields"),
        ({"cron": "* * * * *"}, "at least 5 minutes"),
        ({"timezone": "Mars/Olympus"}, "Mars/Olympus"),
        ({"webhook": {"url": "file:///etc/passwd"}}, "http or https"),
        ({"webhook": {"url": "https://h", "secret": "weak"}}, "secret"),
        ({"options": {"budget_s": 1}}, "budget_s"),
    ],
)
def test_a_schedule_that_cannot_be_kept_is_refused_and_not_kept(api, rig, wrong, word):
    is_problem(api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *", **wrong}), 422, word)
    assert api.get("/schedules", params={"rig": rig}).json()["items"] == []


# ---- live, baseline, audit, operations


def test_a_controller_that_does_not_answer_is_told_as_such(api, rig):
    status = api.get(f"/rigs/{rig}/status").json()
    assert status["reachable"] is False
    assert status["detail"]
    is_problem(api.post(f"/rigs/{rig}/stop"), 503)


def test_a_stop_that_does_not_reach_the_controller_ends_what_would_go_on_or_begin(service, api, rig, experiment):
    """The controller is away for a moment: back again, it must not find a job that knows of nothing."""
    running, waiting, calculated = (
        api.post("/jobs", json={"rig": rig, **body}).json()["id"]
        for body in ({"kind": "experiment"}, {"kind": "health"}, {"kind": "gap", "experiment": experiment})
    )
    with service.services.database.write() as session:
        rows.claim(session, running, 1, "w1")
    is_problem(api.post(f"/rigs/{rig}/stop"), 503, "did not reach the controller", running, waiting)
    with service.services.database.read() as session:
        assert rows.get(session, running).cancel_requested
        assert rows.get(session, waiting).state == "cancelled"
        assert rows.get(session, calculated).state == "queued"
    line = api.get("/audit", params={"rig": rig}).json()["items"][0]
    assert line["action"] == "rotor.released"
    assert line["detail"]["cancelled"].split() == [running, waiting]


def test_a_rig_that_lives_inside_its_job_is_not_shown_as_another_one_and_no_stop_is_claimed(api, request):
    body = {"datasheet": SHEET, "controller_url": "Simulated://?seed=3", "name": request.node.name}
    rig = api.post("/rigs", json=body).json()["id"]
    is_problem(api.get(f"/rigs/{rig}/status"), 409, "cancel its job", "ambit rig serve")
    is_problem(api.post(f"/rigs/{rig}/stop"), 409, "cancel its job")
    lines = api.get("/audit", params={"rig": rig}).json()["items"]
    assert [line["action"] for line in lines] == ["rig.created"]


def test_the_baseline_is_a_model_of_the_rig(api, rig, experiment):
    model = rig.replace("rig_", "mod_")
    tag = {"If-Match": api.get(f"/rigs/{rig}").headers["etag"]}
    is_problem(api.put(f"/rigs/{rig}/baseline", json={"model": model}), 428, tag["If-Match"])
    assert api.put(f"/rigs/{rig}/baseline", json={"model": model}, headers=tag).json()["baseline_model"] == model
    is_problem(api.put(f"/rigs/{rig}/baseline", json={"model": None}, headers=tag), 412)
    job = api.post("/jobs", json={"kind": "health", "rig": rig}).json()
    assert job["options"]["baseline"] == model
    other = api.post("/rigs", json={"datasheet": SHEET, "name": f"other {rig}"}).json()["id"]
    tag = {"If-Match": api.get(f"/rigs/{other}").headers["etag"]}
    is_problem(api.put(f"/rigs/{other}/baseline", json={"model": model}, headers=tag), 409, "another rig")


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
    assert (found["zone"], found["drifted"]) == ("B", ["x.kiA"])
    assert api.get("/health-checks", params={"rig": rig, "alarm": False}).json()["items"] == []
    assert api.get(f"/health-checks/{found['id']}").json()["document"] == document
