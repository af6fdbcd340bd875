"""Schedules: kept by the clock, missed runs told, messages to webhooks, what cannot be kept."""

from datetime import datetime, timedelta

import pytest
from sqlalchemy import select

from service.jobs import timetable
from service.storage import jobs as rows
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ModelRow, ScheduleRow, ScheduleRunRow, WebhookRow
from tests.support.api import assert_problem


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
    again = api.get(f"/schedules/{made['id']}", headers={"If-None-Match": read.headers["etag"]})
    assert (again.status_code, again.json()["next_at"][:10]) == (200, f"{first:%Y-%m-%d}")  # not what the caller has
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
    assert_problem(api.put(f"/schedules/{made['id']}", json=changed), 428)
    answer = api.put(f"/schedules/{made['id']}", json=changed, headers={"If-Match": read.headers["etag"]})
    assert (answer.status_code, answer.json()["webhook"]["secret"]) == (200, None)
    assert api.delete(f"/schedules/{made['id']}").status_code == 204
    assert_problem(api.get(f"/schedules/{made['id']}"), 404)


def remove_webhook(api, body, made):
    tag = api.get(f"/schedules/{made['id']}").headers["etag"]
    without = {**body, "webhook": None}
    assert api.put(f"/schedules/{made['id']}", json=without, headers={"If-Match": tag}).status_code == 200


def remove_schedule(api, body, made):
    assert api.delete(f"/schedules/{made['id']}").status_code == 204


@pytest.mark.parametrize(
    ("remove", "why"),
    [(remove_webhook, "the webhook was removed"), (remove_schedule, "the schedule was removed")],
)
def test_messages_that_wait_for_a_webhook_end_with_it(api, service, rig, remove, why):
    body = {"rig": rig, "cron": "0 6 * * *", "webhook": {"url": "https://plant.example/hook"}}
    made = api.post("/schedules", json=body).json()
    with service.services.database.write() as session:
        common = {"schedule_id": made["id"], "health_id": "hc_1", "url": "u", "created_at": now(), "updated_at": now()}
        session.add_all(WebhookRow(id=f"{rig}{state}"[4:], state=state, **common) for state in ("pending", "delivered"))
    remove(api, body, made)
    with service.services.database.read() as session:
        found = session.scalars(select(WebhookRow).where(WebhookRow.schedule_id == made["id"]))
        assert {(d.id[26:], d.state, d.detail) for d in found} == {
            ("pending", "failed", why),
            ("delivered", "delivered", ""),
        }
    api.delete(f"/schedules/{made['id']}")


def test_a_message_tells_when_it_is_sent_again_where_it_is(api, service, rig):
    body = {"rig": rig, "cron": "0 6 * * *", "webhook": {"url": "https://plant.example/hook"}}
    schedule, at = api.post("/schedules", json=body).json()["id"], now().replace(microsecond=0)
    with service.services.database.write() as session:
        common = {"schedule_id": schedule, "url": "u", "created_at": at, "updated_at": at}
        session.add_all(
            WebhookRow(id=new_id("whd"), state=state, next_at=next_at, **common)
            for state, next_at in (("pending", at + timedelta(hours=1)), ("delivered", None))
        )
    told = {d["state"]: d["next_attempt_at"] for d in api.get(f"/schedules/{schedule}/deliveries").json()["items"]}
    assert told["delivered"] is None
    assert datetime.fromisoformat(told["pending"]) == at + timedelta(hours=1)
    api.delete(f"/schedules/{schedule}")


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


def test_a_schedule_whose_time_zone_a_machine_does_not_know_keeps_no_other_one_back(api, service, rig, experiment):
    """As one whose zone was renamed, after an upgrade or on a machine without that zone; it is told once."""
    database, settings = service.services.database, service.services.settings
    hook = {"url": "https://plant.example/hook", "on": "alarm"}
    lost, other = (
        api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *", "webhook": hook}).json()["id"] for _ in range(2)
    )
    day, minute = timedelta(days=1), timedelta(minutes=1)
    with database.write() as session:
        session.get(ScheduleRow, lost).timezone = "Mars/Olympus"
        first = session.get(ScheduleRow, lost).next_at
    seconds = timedelta(seconds=1)
    assert timetable.keep(database, settings, first + seconds) == 1  # another machine may know the zone
    assert states(api, other) == ["submitted"]
    assert states(api, lost) == []
    for k in range(1, 4):
        assert timetable.keep(database, settings, first + k * minute) == 0
    (run,) = api.get(f"/schedules/{lost}/runs").json()["items"]
    assert run["state"] == "refused"
    assert "no time zone 'Mars/Olympus' is known here" in run["detail"]
    ((kind, told),) = messages(service, lost)
    assert (kind, "Mars/Olympus" in told["sentence"]) == ("health.missed", True)

    # once the zone is known it goes on by its own times; what was not made meanwhile is told with the reason
    with database.write() as session:
        session.get(ScheduleRow, lost).timezone = "UTC"
        session.get(ScheduleRow, other).enabled = False
    assert timetable.keep(database, settings, first + 2 * day + minute) == 1
    assert states(api, lost) == ["submitted", "missed", "refused"]
    ((_, told),) = messages(service, lost)[1:]
    assert (told["missed"], "Mars/Olympus" in told["sentence"]) == (1, True)
    assert api.get(f"/schedules/{lost}").json()["next_at"].startswith(f"{first + 3 * day:%Y-%m-%dT%H:%M}")
    for made in (lost, other):
        api.delete(f"/schedules/{made}")


def test_a_defect_in_one_schedule_keeps_no_other_one_back(api, service, rig, experiment, monkeypatch):
    database, settings = service.services.database, service.services.settings
    broken, other = (api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *"}).json()["id"] for _ in range(2))
    submitted = timetable._submitted

    def breaks(session, settings, row, due):
        if row.id == broken:
            raise RuntimeError("a defect")
        return submitted(session, settings, row, due)

    monkeypatch.setattr(timetable, "_submitted", breaks)
    with database.read() as session:
        due = session.get(ScheduleRow, broken).next_at
    assert timetable.keep(database, settings, due + timedelta(seconds=1)) == 1
    assert (states(api, broken), states(api, other)) == ([], ["submitted"])
    for made in (broken, other):
        api.delete(f"/schedules/{made}")


def states(api, schedule):
    """What became of the times of a schedule, newest first."""
    return [run["state"] for run in api.get(f"/schedules/{schedule}/runs").json()["items"]]


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
        ({"webhook": {"url": "http://127.0.0.1:8311/"}}, "webhook_loopback"),  # this service has a public address
        ({"webhook": {"url": "https://h", "secret": "weak"}}, "secret"),
        ({"options": {"budget_s": 1}}, "budget_s"),
    ],
)
def test_a_schedule_that_cannot_be_kept_is_refused_and_not_kept(api, rig, wrong, word):
    assert_problem(api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *", **wrong}), 422, word)
    assert api.get("/schedules", params={"rig": rig}).json()["items"] == []


def test_a_rig_without_a_controller_is_not_checked_by_a_clock(api, rig):
    sheet = api.get(f"/rigs/{rig}").json()["datasheet"]
    bench = api.post("/rigs", json={"datasheet": sheet, "name": "no controller yet"}).json()["id"]
    refused = api.post("/schedules", json={"rig": bench, "cron": "0 6 * * *"})
    assert_problem(refused, 409)
    assert "no controller_url" in refused.json()["detail"]
    made = api.post("/schedules", json={"rig": bench, "cron": "0 6 * * *", "enabled": False})
    assert made.status_code == 201
    tag = {"If-Match": made.headers.get("etag") or api.get(f"/schedules/{made.json()['id']}").headers["etag"]}
    assert_problem(
        api.put(f"/schedules/{made.json()['id']}", json={"rig": bench, "cron": "0 6 * * *"}, headers=tag), 409
    )
