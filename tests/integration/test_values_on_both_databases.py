"""What one database would keep and the other not is refused on both, at once, as the caller's mistake."""

import json

import httpx
import pytest
from sqlalchemy.exc import DataError

from service.api.resources import rigs
from service.config import Settings
from tests.support.databases import BOTH
from tests.support.service import reference_sheet
from tests.support.serving import serving

SHEET = reference_sheet()
NAME = 'name = "'


@pytest.fixture(scope="module", params=BOTH)
def api(request, tmp_path_factory):
    home = tmp_path_factory.mktemp(f"values-{request.param}")
    if request.param == "sqlite":
        with serving(Settings(home=home, port=0)) as service, client(service) as found:
            yield found
        return
    from tests.support.postgres import empty_database

    with (
        empty_database() as url,
        serving(Settings(home=home, port=0, database_url=url)) as service,
        client(service) as found,
    ):
        yield found


def client(service):
    return httpx.Client(base_url=f"{service.url}/api/v1", timeout=30)


@pytest.fixture(scope="module")
def rig(api):
    return api.post("/rigs", json={"datasheet": SHEET, "name": "bench"}).json()["id"]


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/rigs", {"datasheet": SHEET, "note": "a\0b"}),
        ("POST", "/rigs", {"datasheet": SHEET, "name": "\0"}),
        ("POST", "/rigs", {"datasheet": SHEET.replace(NAME, NAME + r"\u0000", 1)}),
        ("POST", "/rigs", {"datasheet": SHEET.replace(NAME, NAME + "x" * 300, 1)}),
        ("POST", "/jobs", {"kind": "experiment", "rig": "rig_\0"}),
        ("POST", "/jobs", {"kind": "gap", "rig": "{rig}", "experiment": "exp_\0"}),
        ("POST", "/jobs", {"kind": "experiment", "rig": "{rig}", "options": {"profile": {"a\0": [{"b": "\0"}]}}}),
        ("POST", "/schedules", {"rig": "{rig}", "cron": "0 6 * * *", "webhook": {"url": "https://h/\0"}}),
        ("PUT", "/rigs/{rig}/baseline", {"model": "mod_\0"}),
        ("GET", "/jobs?rig=rig_%00", None),
    ],
)
def test_a_nul_or_a_text_that_is_too_long_is_the_callers_mistake(api, rig, method, path, body):
    content = None if body is None else json.dumps(body).replace("{rig}", rig)
    answer = api.request(
        method, path.replace("{rig}", rig), content=content, headers={"content-type": "application/json"}
    )
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json"), answer.text
    assert "retry-after" not in answer.headers
    assert [found["name"] for found in api.get("/rigs").json()["items"]] == ["bench"]


def test_whatever_else_a_database_cannot_keep_is_no_outage(api, rig, monkeypatch):
    def refused(*_):
        raise DataError("INSERT", {}, Exception("value too long"))

    monkeypatch.setattr(rigs.rigs, "create", refused)
    answer = api.post("/rigs", json={"datasheet": SHEET, "name": "another"})
    assert (answer.status_code, "cannot keep" in answer.json()["detail"]) == (422, True)
