"""Lists of the API as their readers rely on them: pages without loss, and nothing sent twice."""

from datetime import timedelta

import httpx
import pytest

from service.config import Settings
from service.storage.database import now
from service.storage.ids import new_id
from service.storage.tables import ExperimentRow, HealthRow, ModelRow, ScheduleRunRow, WebhookRow
from tests.support.service import reference_sheet
from tests.support.serving import serving

SHEET = reference_sheet()


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A client of a service with a rig of three versions, and some of everything that is listed."""
    with (
        serving(Settings(home=tmp_path_factory.mktemp("home"), port=0, requests_per_s=10_000)) as service,
        httpx.Client(base_url=f"{service.url}/api/v1", timeout=30) as api,
    ):
        rig = api.post("/rigs", json={"datasheet": SHEET, "name": "bench"}).json()["id"]
        for k in range(2):
            tag = {"If-Match": api.get(f"/rigs/{rig}").headers["etag"]}
            assert api.put(f"/rigs/{rig}", json={"datasheet": SHEET, "note": str(k)}, headers=tag).status_code == 200
        schedule = api.post("/schedules", json={"rig": rig, "cron": "0 6 * * *", "enabled": False}).json()["id"]
        with service.services.database.write() as session:
            for k in range(3):
                due = now() - timedelta(days=k)
                common = {"rig_id": rig, "rig_version": 1, "created_at": due}
                experiment, model = new_id("exp"), new_id("mod")
                session.add(
                    ExperimentRow(
                        id=experiment, source="measured", complete=True, file_sha256="0" * 64, file_bytes=1,
                        media_type="", file_name="", summary={}, created_by="x", **common,
                    )
                )  # fmt: skip
                session.flush()
                session.add(
                    ModelRow(
                        id=model, experiment_id=experiment, result_sha256="", report_sha256="", plots_sha256="",
                        summary={"planes": {}}, created_by="x", **common,
                    )
                )  # fmt: skip
                session.flush()
                document = {"zone": "A", "drifted": [], "sentence": "", "parameters": {}, "planes": {}}
                session.add_all(
                    [
                        HealthRow(
                            id=new_id("hc"), experiment_id=experiment, model_id=model, document=document, alarm=False,
                            report_sha256="", **common,
                        ),
                        ScheduleRunRow(schedule_id=schedule, due_at=due, state="missed", recorded_at=due),
                        WebhookRow(
                            id=new_id("whd"), schedule_id=schedule, health_id="hc_1", url="", state="failed",
                            created_at=due, updated_at=due,
                        ),
                    ]
                )  # fmt: skip
        for _ in range(2):
            job = {"kind": "identification", "rig": rig, "experiment": experiment}
            assert api.post("/jobs", json=job).status_code == 202
        yield api, rig, schedule


@pytest.fixture(scope="module")
def lists(filled):
    """Addresses of lists, and how many items each has."""
    _, rig, schedule = filled
    return {
        "/rigs": 1, f"/jobs?rig={rig}": 2, f"/experiments?rig={rig}": 3, f"/models?rig={rig}": 3,
        f"/gaps?rig={rig}": 0, f"/health-checks?rig={rig}": 3, f"/schedules?rig={rig}": 1, f"/audit?rig={rig}": 6,
        f"/rigs/{rig}/versions": 3, f"/rigs/{rig}/stiffness": 3, f"/rigs/{rig}/modes": 3,
        f"/schedules/{schedule}/runs": 3, f"/schedules/{schedule}/deliveries": 3,
    }  # fmt: skip


def test_a_list_that_has_not_changed_is_not_sent_again(filled, lists):
    api, rig, _ = filled
    for path in (*lists, f"/rigs/{rig}/trend"):
        first = api.get(path)
        again = api.get(path, headers={"If-None-Match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b""), path
        assert api.get(path, headers={"If-None-Match": '"another"'}).json() == first.json(), path


def test_every_list_is_read_page_by_page_without_loss_or_repetition(filled, lists):
    api, _, _ = filled
    for path, count in lists.items():
        found, after = [], {}
        while after is not None:
            page = api.get(httpx.URL(path).copy_merge_params({"limit": 1, **after})).json()
            found += page["items"]
            after = None if page["next"] is None else {"after": page["next"]}
        assert len(found) == count, path
        assert found == api.get(path).json()["items"], path


@pytest.mark.parametrize(
    "path", ["/experiments?rig={}", "/models?rig={}", "/health-checks?rig={}", "/rigs/{}/stiffness", "/rigs/{}/modes"]
)
def test_results_are_listed_by_when_they_were_made_not_by_when_their_jobs_were_submitted(filled, path):
    """Of the filled service, each has an id above that of the one made the day after."""
    api, rig, _ = filled
    found = api.get(path.format(rig)).json()["items"]
    assert len(found) == 3
    assert found == sorted(found, key=lambda item: item["created_at"], reverse=True)
    assert found == sorted(found, key=lambda item: item.get("id") or item["model"])


def test_the_newest_model_and_diagnosis_of_each_rig_are_asked_for(filled):
    api, rig, _ = filled
    everything = api.get("/models").json()["items"]
    assert api.get("/models", params={"newest": True}).json()["items"] == everything[:1]
    assert api.get("/models", params={"newest": True, "rig": rig}).json()["items"] == everything[:1]
    assert api.get("/gaps", params={"newest": True}).json()["items"] == []


def test_a_trend_goes_back_page_by_page(filled):
    api, rig, _ = filled
    whole = api.get(f"/rigs/{rig}/trend").json()["checks"]
    assert whole[::-1] == [check["id"] for check in api.get(f"/health-checks?rig={rig}").json()["items"]]
    newest = api.get(f"/rigs/{rig}/trend", params={"limit": 2}).json()
    before = api.get(f"/rigs/{rig}/trend", params={"limit": 2, "after": newest["next"]}).json()
    assert len(whole) == 3
    assert before["checks"] + newest["checks"] == whole
    assert before["next"] is None
