"""What stands behind the question mark: a filter or a cursor that means nothing is told, and never passed over."""

import re

import httpx
import pytest

from tests.support.api import assert_problem


@pytest.fixture(scope="module")
def document(service):
    return httpx.get(f"{service.url}/openapi.json").json()


@pytest.fixture(scope="module")
def operations(document):
    return [(path, method, told) for path, ways in document["paths"].items() for method, told in ways.items()]


def test_every_address_refuses_a_query_parameter_that_it_does_not_know(service, operations):
    assert len(operations) > 40
    for path, method, told in operations:
        known = [p["name"] for p in told.get("parameters", ()) if p["in"] == "query"]
        address = service.url + re.sub(r"\{(\w+)_id\}", r"\1_1", path)
        for name in ("stat", "LIMIT", "Rig", "after[]", ""):
            answer = httpx.request(method, address, params={name: "failed"})
            assert_problem(answer, 422, f"unknown query parameter {name!r}", *known)
            assert [e["field"] for e in answer.json()["errors"]] == [f"query.{name}"]
            assert known or "it knows none" in answer.json()["detail"]
            assert "422" in told["responses"], f"{method} {path} does not announce it"


def test_every_parameter_that_is_described_is_known(service, operations):
    for path, method, told in operations:
        for parameter in told.get("parameters", ()):
            if parameter["in"] == "query":
                address = service.url + re.sub(r"\{(\w+)_id\}", r"\1_1", path)
                answer = httpx.request(method, address, params={parameter["name"]: "x"})
                assert "unknown query" not in answer.text, (method, path, parameter["name"])


def test_a_misspelt_filter_beside_a_good_one_is_named_with_those_that_there_are(api):
    answer = api.get("/jobs", params={"state": "failed", "rigs": "rig_1", "limt": 3})
    assert_problem(answer, 422, "'limt', 'rigs'", "after, kind, limit, rig, state")


def test_a_method_that_there_is_not_is_told_as_that(api):
    assert_problem(api.patch("/jobs", params={"stat": "x"}), 405, "PATCH")
