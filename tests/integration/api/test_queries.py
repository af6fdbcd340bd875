"""What stands behind the question mark: a filter or a cursor that means nothing is told, and never passed over."""

import re

import httpx
import pytest

from tests.support.api import assert_problem

MADE = ".1764547200000000"
"""In the cursor of a list of what jobs make: when that was, µs since 1970."""


@pytest.fixture(scope="module")
def document(service):
    return httpx.get(f"{service.url}/openapi.json").json()


@pytest.fixture(scope="module")
def operations(document):
    return [(path, method, told) for path, ways in document["paths"].items() for method, told in ways.items()]


def test_every_address_refuses_a_query_parameter_that_it_does_not_know(service, api, operations):
    assert len(operations) > 40
    for path, method, told in operations:
        known = [p["name"] for p in told.get("parameters", ()) if p["in"] == "query"]
        address = service.url + re.sub(r"\{(\w+)_id\}", r"\1_1", path)
        for name in ("stat", "LIMIT", "Rig", "after[]", ""):
            answer = api.request(method, address, params={name: "failed"})
            assert_problem(answer, 422, f"unknown query parameter {name!r}", *known)
            assert [e["field"] for e in answer.json()["errors"]] == [f"query.{name}"]
            assert known or "it knows none" in answer.json()["detail"]
            assert "422" in told["responses"], f"{method} {path} does not announce it"


def test_every_parameter_that_is_described_is_known(service, api, operations):
    for path, method, told in operations:
        for parameter in told.get("parameters", ()):
            if parameter["in"] == "query":
                address = service.url + re.sub(r"\{(\w+)_id\}", r"\1_1", path)
                answer = api.request(method, address, params={parameter["name"]: "x"})
                assert "unknown query" not in answer.text, (method, path, parameter["name"])


def test_a_misspelt_filter_beside_a_good_one_is_named_with_those_that_there_are(api):
    answer = api.get("/jobs", params={"state": "failed", "rigs": "rig_1", "limt": 3})
    assert_problem(answer, 422, "'limt', 'rigs'", "after, kind, limit, newest, rig, state")


def test_a_method_that_there_is_not_is_told_as_that(api):
    assert_problem(api.patch("/jobs", params={"stat": "x"}), 405, "PATCH")


@pytest.mark.parametrize(
    ("address", "kind", "own", "when"),
    [
        ("/rigs", "a rig", "rig", ""),
        ("/jobs", "a job", "job", ""),
        ("/experiments", "an experiment", "exp", MADE),
        ("/models", "a model", "mod", MADE),
        ("/gaps", "a gap diagnosis", "gap", MADE),
        ("/health-checks", "a health check", "hc", MADE),
        ("/schedules", "a schedule", "sch", ""),
        ("/audit", "a line of the audit log", "aud", ""),
        ("/rigs/{rig}/stiffness", "a model", "mod", MADE),
        ("/rigs/{rig}/modes", "a model", "mod", MADE),
        ("/rigs/{rig}/trend", "a health check", "hc", MADE),
    ],
)
def test_a_cursor_that_no_page_has_given_is_told_and_gives_no_list(api, rig, address, kind, own, when):
    other = "job" if own != "job" else "rig"
    last = rig.replace("rig_", f"{own}_")
    wrong = ["page2", f"{own}_1", f"{own}_zzzzzzzzzzzzzzzzzzzzzzzzzz", last.replace(f"{own}_", f"{other}_") + when, ""]
    for bad in [*wrong, last, f"{last}.", f"{last}.-1"] if when else wrong:
        answer = api.get(address.format(rig=rig), params={"after": bad})
        assert_problem(answer, 422, "query.after", f"the id of {kind}", f"{own}_01k9", "`next`")
    good = api.get(address.format(rig=rig), params={"after": last + when})
    assert good.status_code == 200, good.text


@pytest.mark.parametrize("time", ["0", "9" * 16])
def test_a_cursor_of_any_time_is_one(api, rig, time):
    assert api.get("/models", params={"after": rig.replace("rig_", "mod_") + "." + time}).status_code == 200


def test_an_id_that_is_none_is_told_in_words(api):
    words = "the id of a rig, rig_ and 26 digits and small letters, as rig_01k9abcdefghjkmnpqrstvwxyz; not its name"
    for name in ("bench", "RIG_01K9ABCDEFGHJKMNPQRSTVWXYZ", "rig_1"):
        for address in ("/jobs", "/models", "/schedules", "/audit"):
            answer = api.get(address, params={"rig": name})
            assert_problem(answer, 422, "query.rig", words, f"{name!r} is none")
            assert "pattern" not in answer.text
    assert_problem(api.get("/audit", params={"subject": "bench 3"}), 422, "query.subject", "id", "as job_01k9")
