"""Every route asks the gate: it lets the right callers in, and tells the others why not."""

from datetime import timedelta
from typing import Annotated

import pytest
from fastapi import Depends, FastAPI
from fastapi.responses import JSONResponse
from starlette.testclient import TestClient

from service.access import keys
from service.access.errors import ForbiddenError, RateError, UnauthorisedError
from service.access.keys import Identity, Scope
from service.access.rate import Rate
from service.api import access
from service.storage import audit, migrate
from service.storage import keys as rows
from service.storage.database import Database, now
from service.storage.ids import new_id


@pytest.fixture
def database(tmp_path):
    database = Database(f"sqlite:///{tmp_path / 'a.db'}")
    migrate.upgrade(database)
    yield database
    database.close()


@pytest.fixture
def client(database):
    app = FastAPI()
    app.router.route_class = access.KeyFirst
    app.state.gate = access.Gate(database, Rate(1000.0, 30))
    statuses = {UnauthorisedError: 401, ForbiddenError: 403, RateError: 429}
    for kind, status in statuses.items():
        app.add_exception_handler(kind, lambda _, e, status=status: JSONResponse({"detail": str(e)}, status))

    @app.get("/view")
    def view(who: Annotated[Identity, Depends(access.require(Scope.viewer))]) -> str:
        return who.name

    @app.post("/move")
    def move(who: Annotated[Identity, Depends(access.require(Scope.operator))]) -> str:
        return who.name

    with TestClient(app, client=("127.0.0.1", 50000), base_url="http://127.0.0.1:8311") as client:
        yield client


def made(database, scope: Scope, name: str = "laptop", **times) -> tuple[str, dict[str, str]]:
    record, key = keys.issue(new_id("key"), name, scope, times.get("at"), times.get("expires"))
    with database.write() as session:
        rows.add(session, rows.row(record, "test"))
    return record.id, {"Authorization": f"Bearer {key}"}


def test_without_any_key_this_machine_is_served(client):
    assert client.get("/view").json() == "local"
    assert client.post("/move").status_code == 200


def test_without_any_key_another_name_is_not_served(client):
    assert client.get("/view", headers={"Host": "example.org"}).status_code == 401


def test_once_there_is_a_key_nobody_comes_in_without(client, database):
    key_id, header = made(database, Scope.operator)
    assert client.get("/view").status_code == 401
    assert client.post("/move", headers=header).json() == "laptop"
    with database.write() as session:
        rows.revoke(session, key_id)
    answer = client.post("/move", headers=header)
    assert (answer.status_code, "revoked" in answer.json()["detail"]) == (401, True)
    assert client.get("/view").status_code == 401  # the last key revoked does not open the door


def test_a_viewer_moves_no_rotor(client, database):
    _, header = made(database, Scope.viewer)
    assert client.get("/view", headers=header).status_code == 200
    answer = client.post("/move", headers=header)
    assert answer.status_code == 403
    assert "operator" in answer.json()["detail"]


def test_an_expired_key_is_refused(client, database):
    yesterday = now() - timedelta(days=1)
    _, header = made(database, Scope.admin, at=yesterday, expires=yesterday + timedelta(hours=1))
    assert client.get("/view", headers=header).status_code == 401


@pytest.mark.parametrize("header", ["Bearer x", "Bearer ambit_a_b", "Basic YTpi", "Bearer", "ambit_x_y"])
def test_what_is_no_key_is_not_taken_for_nobody(client, header):
    assert client.get("/view", headers={"Authorization": header}).status_code == 401


def test_a_key_is_limited_and_another_is_not(client, database):
    _, first = made(database, Scope.viewer, "first")
    _, second = made(database, Scope.viewer, "second")
    client.app.state.gate = access.Gate(database, Rate(0.01, 5))
    assert [client.get("/view", headers=first).status_code for _ in range(6)] == [200] * 5 + [429]
    assert client.get("/view", headers=second).status_code == 200


def test_guessing_keys_is_slow(client, database):
    made(database, Scope.viewer)
    guess = {"Authorization": f"Bearer ambit_{'0' * 26}_{'0' * 48}"}
    answers = [client.get("/view", headers=guess).status_code for _ in range(access.FAILURES.burst + 5)]
    assert answers[0] == 401
    assert answers[-1] == 429


def refusals(database) -> list[tuple[str, str, str, str]]:
    with database.read() as session:
        found = audit.listed(session, action="access.refused", limit=1000).items
        return [(row.who, row.key_id, row.resource, row.detail["route"]) for row in found]


def test_who_was_not_let_in_is_in_the_audit_log(client, database):
    key_id, header = made(database, Scope.viewer)
    assert client.post("/move", headers=header).status_code == 403
    assert refusals(database) == [("laptop", key_id, key_id, "POST /move")]
    with database.write() as session:
        rows.revoke(session, key_id)
    other = TestClient(client.app, client=("10.0.0.1", 1))
    assert other.get("/view", headers=header).status_code == 401
    assert refusals(database)[0] == ("nobody", "", key_id, "GET /view")
    assert TestClient(client.app, client=("10.0.0.2", 1)).get("/view").status_code == 401
    assert refusals(database)[0] == ("nobody", "", "", "GET /view")


def test_a_flood_of_refusals_does_not_fill_the_audit_log(client, database):
    made(database, Scope.viewer)
    for _ in range(10):
        client.get("/view")
    assert len(refusals(database)) == 1
    for k in range(access.ALL_REFUSALS.burst + 30):
        TestClient(client.app, client=(f"10.0.{k}.1", 1)).get("/view")
    assert len(refusals(database)) < access.ALL_REFUSALS.burst + 20


def test_the_last_use_of_a_key_is_kept(client, database):
    key_id, header = made(database, Scope.viewer)
    client.get("/view", headers=header)
    with database.read() as session:
        row = rows.find(session, key_id)
        assert abs(row.used_at - now()) < timedelta(minutes=1)
        assert row.used_from == "127.0.0.1"
