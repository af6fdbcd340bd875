"""A rig as it is now: its controller away, a stop by hand, a rig that nobody else sees."""

from service.storage import jobs as rows
from tests.support.api import assert_problem
from tests.support.service import reference_sheet

SHEET = reference_sheet()


def test_a_controller_that_does_not_answer_is_told_as_such(api, rig):
    status = api.get(f"/rigs/{rig}/status").json()
    assert status["reachable"] is False
    assert status["detail"]
    assert_problem(api.post(f"/rigs/{rig}/stop"), 503)


def test_a_stop_that_does_not_reach_the_controller_ends_what_would_go_on_or_begin(service, api, rig, experiment):
    """The controller is away for a moment: back again, it must not find a job that knows of nothing."""
    running, waiting, calculated = (
        api.post("/jobs", json={"rig": rig, **body}).json()["id"]
        for body in ({"kind": "experiment"}, {"kind": "health"}, {"kind": "gap", "experiment": experiment})
    )
    with service.services.database.write() as session:
        rows.claim(session, running, 1, "w1")
    assert_problem(api.post(f"/rigs/{rig}/stop"), 503, "did not reach the controller", running, waiting)
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
    assert_problem(api.get(f"/rigs/{rig}/status"), 409, "cancel its job", "ambit rig serve")
    assert_problem(api.post(f"/rigs/{rig}/stop"), 409, "cancel its job")
    lines = api.get("/audit", params={"rig": rig}).json()["items"]
    assert [line["action"] for line in lines] == ["rig.created"]
