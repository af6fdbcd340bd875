"""The description of the API tells what a program needs to be written from it alone."""

import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from jsonschema import Draft202012Validator
from starlette.testclient import TestClient

from drivers.controller import Tone
from drivers.device.limits import check_tone
from drivers.errors import LimitError
from drivers.simulated.driver import SimulatedController
from service.api.app import create_app
from service.api.problems import UnprocessableError
from service.api.resources.options import checked_options
from service.config import Settings
from service.experiment import file
from sim.reference import reference_rig

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    app = create_app(Settings(home=tmp_path_factory.mktemp("home")))
    with TestClient(app, base_url="http://127.0.0.1", client=("127.0.0.1", 1)) as found:
        yield found


@pytest.fixture(scope="module")
def document(client):
    return client.get("/openapi.json").json()


def answers(document):
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                yield f"{method} {path} {status}", operation, status, response["headers"]


def test_headers_of_answers_are_described(document):
    for name, operation, status, headers in answers(document):
        assert "X-Request-Id" in headers, name
        assert (status in ("429", "503")) == ("Retry-After" in headers), name
        sent = {p["name"] for p in operation.get("parameters", []) if p["in"] == "header"}
        if "if-none-match" in sent and status in ("200", "304"):
            assert headers["ETag"]["required"], name
        if "idempotency-key" in sent and status in ("201", "202"):
            assert {"Location", "Idempotent-Replayed"} <= set(headers), name


def test_what_answers_send_is_what_is_described(client, document):
    answer = client.get("/api/v1/rigs")
    described = document["paths"]["/api/v1/rigs"]["get"]["responses"]["200"]["headers"]
    for name in ("X-Request-Id", "ETag"):
        assert name in answer.headers
        assert name in described


def test_examples_are_what_their_shapes_allow(document):
    """Also what is null in them: ``{"model": null}`` chooses the newest model, and ``{}`` is refused."""
    wrong, seen = {}, 0
    for name, schema in document["components"]["schemas"].items():
        whole = Draft202012Validator(schema | {"components": document["components"]})
        for example in schema.get("examples", []):
            seen += 1
            if errors := [e.message for e in whole.iter_errors(example)]:
                wrong[name] = errors
    assert wrong == {}
    assert seen > 20
    assert {"model": None} in document["components"]["schemas"]["BaselineWanted"]["examples"]


def test_options_of_a_job_are_described_with_their_ranges(document):
    schemas = document["components"]["schemas"]
    options = schemas["JobWanted"]["properties"]["options"]
    kinds = {ref["$ref"].rpartition("/")[2] for ref in options["anyOf"]}
    assert {"SteppedSineOptions", "MultisineOptions", "IdentificationOptions", "HealthOptions"} <= kinds
    assert schemas["ProfileOptions"]["properties"]["accuracy"]["maximum"] == 0.5
    assert schemas["HealthOptions"]["properties"]["budget_s"]["minimum"] == 20
    for name in ("ProfileOptions", "MultisineProfileOptions", "HealthOptions"):
        for figure, described in schemas[name]["properties"].items():
            assert described["description"], f"{name}.{figure}"


@pytest.mark.parametrize("content_type", ["text/plain", "application/x-www-form-urlencoded"])
def test_a_body_that_is_no_json_gets_the_status_that_is_described(client, document, content_type):
    assert "415" in document["paths"]["/api/v1/jobs"]["post"]["responses"]
    body = b'{"kind": "experiment", "rig": "rig_1"}'
    answer = client.post("/api/v1/jobs", content=body, headers={"content-type": content_type})
    assert (answer.status_code, answer.headers["content-type"]) == (415, "application/problem+json")
    assert "application/json" in answer.json()["detail"]
    sent = client.post("/api/v1/jobs", content=b"{", headers={"content-type": "application/json"})
    assert sent.status_code == 422


def test_metrics_are_not_said_to_need_a_key(document):
    assert not {"401", "403"} & set(document["paths"]["/metrics"]["get"]["responses"])


def test_pages_that_the_description_names_are_there(client):
    named = set(re.findall(r"docs/[\w./-]+", client.get("/openapi.json").text))
    assert named == {"docs/experiment-file.md"}
    assert all((ROOT / page).is_file() for page in named)


def test_the_experiment_file_of_the_page_is_read(tmp_path, monkeypatch):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/experiment-file.md").read_text(), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    read = file.read(tmp_path / "experiment.h5")
    assert read.axes == ("xA", "xB")
    assert (read.main.n_points, read.main.R.shape) == (120, (120, 4, 1, 2))
    with h5py.File(tmp_path / "experiment.h5") as written:
        assert np.all(written["sweeps/0/axis"][:2] == [0, 1])


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"profile": {"from_hz": 5000, "to_hz": 100}}, "from_hz must be below to_hz"),
        ({"profile": {"from_hz": 5000}}, "from_hz must be below to_hz"),
        ({"excitation": "multisine", "profile": {"from_hz": 500, "to_hz": 500}}, "from_hz must be below to_hz"),
        ({"profile": "thorough"}, "options.profile"),
        ({"comment": "nobody reads this"}, "options.comment"),
        ({"excitation": "chirp"}, "options.excitation"),
    ],
)
def test_options_that_mean_nothing_are_refused(options, word):
    with pytest.raises(UnprocessableError, match=word):
        checked_options("experiment", options)


def test_options_are_kept_as_they_were_given():
    given = {"profile": {"from_hz": 20.0}, "identify": False}
    assert checked_options("experiment", given) == given


def test_no_more_blocks_are_accepted_than_a_controller_plays(document):
    """A campaign would end at its first tone."""
    most = document["components"]["schemas"]["ProfileOptions"]["properties"]["blocks"]["maximum"]
    with closing(SimulatedController(reference_rig())) as controller:
        tone = Tone(axis=0, amplitude_a=0.1, periods=10, samples=1000, blocks=most)
        check_tone(tone, controller.capabilities())
        with pytest.raises(LimitError, match=f"1 to {most} blocks"):
            check_tone(replace(tone, blocks=most + 1), controller.capabilities())
    checked_options("experiment", {"profile": {"blocks": most}})
    with pytest.raises(UnprocessableError, match=r"options\.profile\.blocks"):
        checked_options("experiment", {"profile": {"blocks": most + 1}})


def test_a_person_reads_the_description_without_any_other_server(client):
    page = client.get("/docs")
    assert page.status_code == 200
    assert "default-src 'none'" in page.headers["content-security-policy"]
    assert "://" not in page.text
    for name in re.findall(r'(?:src|href)="(web/[\w.]+)"', page.text):
        assert client.get(f"/{name}").status_code == 200, name


@pytest.mark.parametrize("path", ["/healthz", "/", "/api/v1/rigs"])
def test_head_is_get_without_the_body(client, path):
    headers = {"accept-encoding": "identity"}
    head, get = client.head(path, headers=headers), client.get(path, headers=headers)
    assert (head.status_code, head.content) == (200, b"")
    for name in ("content-type", "content-length"):
        assert head.headers.get(name) == get.headers.get(name), name


def test_a_method_that_means_nothing_is_told_those_that_do(client):
    assert client.put("/api/v1/rigs").headers["allow"] == "GET, HEAD, POST"
    assert client.post("/healthz").headers["allow"] == "GET, HEAD"
    assert client.post("/api/v1/rigs/rig_1").headers["allow"] == "DELETE, GET, HEAD, PUT"
