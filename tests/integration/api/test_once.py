"""Requests that are sent again: done once under an Idempotency-Key."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import SimpleNamespace

from sqlalchemy import select

from service.access.keys import LOCAL
from service.api.once import Answer, once
from service.errors import ConflictError
from service.storage.tables import JobRow
from tests.support.api import assert_problem, commissioned
from tests.support.uploads import good


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
    assert_problem(api.post("/jobs", json={**body, "priority": 1}, headers=headers), 422, "another request")


def test_a_request_that_is_sent_again_while_it_is_under_way_gets_the_first_answer(service, rig):
    """It is refused for what the first one did, as a rig's name that is taken, once that is done."""
    request = SimpleNamespace(method="POST", url=SimpleNamespace(path="/api/v1/rigs"))
    ask = partial(once, service.services.database, LOCAL, request, f"under way {rig}", "")

    def taken(session):
        raise ConflictError("the name is taken")

    first = Answer(201, f"/api/v1/rigs/{rig}", {"id": rig})
    assert ask(taken, before=lambda: ask(lambda _: first)) == (first, True)


def test_a_retry_that_is_sent_again_is_done_once(api, service, rig, experiment):
    job = api.post("/jobs", json={"kind": "gap", "rig": rig, "experiment": experiment}).json()["id"]
    api.post(f"/jobs/{job}/cancel")
    headers = {"Idempotency-Key": f"retry {rig}"}
    first, second = (api.post(f"/jobs/{job}/retry", headers=headers) for _ in range(2))
    assert (first.status_code, second.status_code) == (202, 202)
    assert first.json() == second.json()
    assert "idempotent-replayed" in second.headers
    assert api.get(f"/jobs/{job}").json()["run"] == 2
    assert_problem(api.post(f"/jobs/{job}/retry"), 409, "only what failed")


def test_a_refused_request_may_be_sent_again_under_its_key(api, service, rig):
    """A refusal is not remembered: what stood in its way is removed, and the same request is done."""
    headers = {"Idempotency-Key": f"refused {rig}"}
    body = {"kind": "health", "rig": rig}
    assert_problem(api.post("/jobs", json=body, headers=headers), 404, "commission it first")
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
    assert_problem(api.post(f"/rigs/{rig}/experiments", content=other, headers=headers), 422, "another request")
    assert len(api.get("/experiments", params={"rig": rig}).json()["items"]) == 1
