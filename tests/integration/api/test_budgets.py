"""A health check whose budget holds no measurement of its rig is refused before it waits, by a clock or not."""

import json

import pytest

from service.cli import run
from tests.support.api import assert_problem, commissioned
from tests.support.commissioned import result

BY_THE_CLOCK = {"cron": "0 6 * * *"}
TOLD = ("options.budget_s: 25 s of rig time hold no health check of this rig", "budget_s of at least")


@pytest.fixture
def checked(service, rig):
    """A rig that can be checked."""
    commissioned(service, rig, json.dumps(result()).encode())
    return rig


def least(api, rig) -> float:
    answer = api.post("/jobs", json={"rig": rig, "kind": "health", "options": {"budget_s": 25}})
    assert_problem(answer, 422, *TOLD)
    return float(answer.json()["detail"].rpartition(" ")[2])


def test_a_check_that_its_budget_cannot_hold_is_refused_with_the_least_that_will_do(api, checked):
    enough = {"budget_s": least(api, checked)}
    assert api.get("/jobs", params={"rig": checked}).json()["items"] == []
    assert api.post("/jobs", json={"rig": checked, "kind": "health", "options": enough}).status_code == 202


def test_a_schedule_of_such_checks_is_refused_but_may_be_switched_off(api, checked):
    small, enough = {"budget_s": 25}, {"budget_s": least(api, checked)}
    wanted = {"rig": checked, **BY_THE_CLOCK}
    assert_problem(api.post("/schedules", json=wanted | {"options": small}), 422, *TOLD)
    assert api.get("/schedules", params={"rig": checked}).json()["items"] == []
    made = api.post("/schedules", json=wanted | {"options": enough}).json()
    place = f"/schedules/{made['id']}"
    tag = {"If-Match": api.get(place).headers["etag"]}
    assert_problem(api.put(place, json=wanted | {"options": small}, headers=tag), 422, *TOLD)
    off = wanted | {"options": small, "enabled": False}
    assert api.put(place, json=off, headers=tag).status_code == 200


@pytest.mark.parametrize("damaged", [None, b"no JSON", b"{}"])
def test_what_is_not_known_yet_is_left_to_the_check(api, rig, service, damaged):
    """Before its commissioning a rig may have a schedule; a result that cannot be read is the job's to tell."""
    small = {"options": {"budget_s": 25}}
    assert api.post("/schedules", json={"rig": rig, **BY_THE_CLOCK, **small}).status_code == 201
    commissioned(service, rig, damaged)
    assert api.post("/jobs", json={"rig": rig, "kind": "health", **small}).status_code == 202


def test_what_was_made_before_is_told_again_to_whoever_sends_the_request_again(api, rig, service):
    """A schedule was made, its answer was lost, and meanwhile the rig has a baseline by which it would be refused."""
    wanted = {"rig": rig, **BY_THE_CLOCK, "options": {"budget_s": 25}}
    key = {"Idempotency-Key": "lost"}
    made = api.post("/schedules", json=wanted, headers=key)
    commissioned(service, rig, json.dumps(result()).encode())
    again = api.post("/schedules", json=wanted, headers=key)
    assert (again.status_code, again.json()) == (201, made.json())
    assert_problem(api.post("/schedules", json=wanted), 422, *TOLD)
    assert api.put("/schedules/sch_0", json=wanted, headers={"If-Match": '"1"'}).status_code == 404
    place = f"/schedules/{made.json()['id']}"
    assert api.put(place, json=wanted, headers={"If-Match": '"stale"'}).status_code == 412


def test_a_command_names_the_option(api, service, checked, capsys):
    words = ["submit", "health", "--rig", checked, "--option", "budget_s=25", "--url", service.url]
    assert run(words) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "--option" in told
    assert "25 s of rig time" in told
