"""Rigs: versions and ETags, the baseline, retirement, histories."""

from service.storage import jobs as rows
from service.storage.tables import ModelRow, RigVersion
from tests.support.api import assert_problem
from tests.support.service import reference_sheet

SHEET = reference_sheet()


def test_only_who_has_read_the_newest_version_changes_a_rig(api, rig):
    read = api.get(f"/rigs/{rig}")
    assert api.get(f"/rigs/{rig}", headers={"If-None-Match": read.headers["etag"]}).status_code == 304
    body = {"datasheet": SHEET, "controller_url": "modbus://127.0.0.1:10", "note": "moved"}
    assert_problem(api.put(f"/rigs/{rig}", json=body), 428, read.headers["etag"])
    changed = api.put(f"/rigs/{rig}", json=body, headers={"If-Match": read.headers["etag"]})
    assert (changed.status_code, changed.json()["version"]) == (200, 2)
    assert_problem(api.put(f"/rigs/{rig}", json=body, headers={"If-Match": read.headers["etag"]}), 412)
    assert [v["version"] for v in api.get(f"/rigs/{rig}/versions").json()["items"]] == [2, 1]
    assert api.get(f"/rigs/{rig}", params={"version": 1}).json()["controller_url"] == "modbus://127.0.0.1:9"
    assert_problem(api.get(f"/rigs/{rig}", params={"version": 7}), 404, "1 to 2")


def test_a_job_keeps_the_version_that_it_was_submitted_for(api, rig):
    job = api.post("/jobs", json={"kind": "experiment", "rig": rig}).json()
    tag = api.get(f"/rigs/{rig}").headers["etag"]
    api.put(f"/rigs/{rig}", json={"datasheet": SHEET, "note": "later"}, headers={"If-Match": tag})
    assert api.get(f"/jobs/{job['id']}").json()["rig_version"] == 1


def test_a_datasheet_that_newer_rules_refuse_is_shown_and_can_be_changed(api, rig, service):
    """It was kept by an earlier version; the other rigs are listed beside it."""
    far = SHEET.replace("[0.418, 0.404]", "[6.0, 0.404]")
    assert_problem(api.post("/rigs", json={"datasheet": far, "name": f"far {rig}"}), 422, "no rig has more than 5")
    with service.services.database.write() as session:
        session.get(RigVersion, (rig, 1)).datasheet = far
    read = api.get(f"/rigs/{rig}")
    assert (read.status_code, read.json()["axes"], read.json()["datasheet"]) == (200, ["xA", "xB", "yA", "yB"], far)
    assert rig in [r["id"] for r in api.get("/rigs", params={"limit": 1000}).json()["items"]]
    changed = api.put(f"/rigs/{rig}", json={"datasheet": SHEET}, headers={"If-Match": read.headers["etag"]})
    assert (changed.status_code, changed.json()["version"]) == (200, 2)


def test_the_baseline_is_a_model_of_the_rig(api, rig, experiment):
    model = rig.replace("rig_", "mod_")
    tag = {"If-Match": api.get(f"/rigs/{rig}").headers["etag"]}
    assert_problem(api.put(f"/rigs/{rig}/baseline", json={"model": model}), 428, tag["If-Match"])
    assert api.put(f"/rigs/{rig}/baseline", json={"model": model}, headers=tag).json()["baseline_model"] == model
    assert_problem(api.put(f"/rigs/{rig}/baseline", json={"model": None}, headers=tag), 412)
    job = api.post("/jobs", json={"kind": "health", "rig": rig}).json()
    assert job["options"]["baseline"] == model
    other = api.post("/rigs", json={"datasheet": SHEET, "name": f"other {rig}"}).json()["id"]
    tag = {"If-Match": api.get(f"/rigs/{other}").headers["etag"]}
    assert_problem(api.put(f"/rigs/{other}/baseline", json={"model": model}, headers=tag), 409, "another rig")


def test_a_model_whose_figures_say_nothing_is_no_baseline(api, rig, experiment, service):
    """Neither chosen nor taken as the newest; an older one is."""
    good = rig.replace("rig_", "mod_")
    nothing = f"{good}z"
    with service.services.database.write() as session:
        row = session.get(ModelRow, good)
        kept = {c.key: getattr(row, c.key) for c in ModelRow.__table__.columns}
        session.add(ModelRow(**kept | {"id": nothing, "summary": row.summary | {"identified": False}}))
    assert api.post("/jobs", json={"kind": "health", "rig": rig}).json()["options"]["baseline"] == good
    tag = {"If-Match": api.get(f"/rigs/{rig}").headers["etag"]}
    assert_problem(api.put(f"/rigs/{rig}/baseline", json={"model": nothing}, headers=tag), 409, "say nothing")


def test_a_retired_rig_takes_no_jobs_and_keeps_its_history(api, rig):
    assert api.delete(f"/rigs/{rig}").status_code == 204
    assert_problem(api.post("/jobs", json={"kind": "experiment", "rig": rig}), 409, "retired")
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
    assert_problem(api.post(f"/jobs/{waits}/retry"), 409, "retired")
    assert api.get(f"/jobs/{waits}").json()["state"] == "cancelled"


def test_histories_are_of_the_rig(api, rig, experiment):
    found = api.get(f"/rigs/{rig}/stiffness").json()["items"]
    assert [entry["planes"]["x"]["kiA"]["value"] for entry in found] == [181.0]
    assert api.get(f"/rigs/{rig}/trend").json() == {"rig": rig, "checks": [], "next": None, "series": {}}
