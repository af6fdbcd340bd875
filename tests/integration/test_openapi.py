"""The API is what its description says: no request ends in an error of the service or in an answer nobody announced.

schemathesis makes the requests from the description itself, right and wrong ones, and sends them to the running
application, which has a rig, an experiment, a model, a diagnosis, a health check, a schedule and jobs.
"""

import httpx
import pytest
from scipy.io import loadmat

from service.access.keys import Scope
from service.client import Client, ConflictingError
from service.config import Settings
from tests.support.described import UNLIMITED, filled, tried
from tests.support.serving import serving

pytestmark = pytest.mark.slow

EXAMPLES = 1
"""Random requests of each operation, beside those that look at its borders; `benchmarks/openapi.py` makes many."""
HANGS_S = 1200
"""The number of requests bounds the run; this is for one that hangs, on a machine however busy."""


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    home = tmp_path_factory.mktemp("home")
    with serving(Settings(home=home, **UNLIMITED)) as service:
        key = service.key(Scope.admin)
        yield service, key, filled(service, key, home)


def test_the_client_reads_one_of_everything(described, tmp_path):
    service, key, ids = described
    with Client(service.url, key) as client:
        model = client.models.get(ids["model_id"])
        assert model.summary["planes"]["x"]["stiffness"]["kiA"]["value"] > 0
        assert client.models.result(model.id)["format"] == "amb-commissioning-result"
        plant = client.models.state_space(model.id)["x"].plant
        assert len(plant.A) == len(plant.B) > 0
        for curve in (client.models.nyquist, client.models.step):
            assert "x" in curve(model.id)
        assert client.models.curves(model.id)["format"] == "amb-model-curves"
        for link in model.links.values():
            assert client._transport.content(link.removeprefix("/api/v1")), link
        matrices = loadmat(client.models.export_state_space(model.id, tmp_path / "x.mat"))
        assert matrices["A"].shape == (len(plant.A), len(plant.A))
        exported = client.experiments.export_responses(ids["experiment_id"], tmp_path / "x.csv", format="csv")
        assert exported.stat().st_size > 0
        (stiffness,) = client.rigs.stiffness(ids["rig_id"])
        assert stiffness.planes["x"]["kiA"].value == model.summary["planes"]["x"]["stiffness"]["kiA"]["value"]
        (modes,) = client.rigs.modes(ids["rig_id"])
        assert modes.planes["x"][0].natural_frequency_rad_s.value > 0
        assert "rig.created" in [line.action for line in client.audit.list(rig=ids["rig_id"])]
        assert client.models.frequency_response(model.id)
        for newest in (None, True):
            assert [m.id for m in client.models.list(ids["rig_id"], newest)] == [model.id]
        assert client.gaps.document(ids["gap_id"])["format"] == "amb-gap-report"
        assert [g.id for g in client.gaps.list(newest=True)] == [g.id for g in client.gaps.list()] == [ids["gap_id"]]
        check = client.health.get(ids["health_id"])
        assert check.document["format"] == "amb-health-check"
        assert [c.sentence for c in client.health.list(alarm=check.alarm)] == [check.sentence]
        trend = client.health.trend(ids["rig_id"])
        assert trend.checks == [check.id]
        assert len(trend.series["x.kiA"].change_percent) == 1
        (missed,) = client.schedules.runs(ids["schedule_id"])
        assert missed.state == "missed"
        made = client.schedules.create(ids["rig_id"], "0 6 * * 1", webhook_url="https://plant.example/hook")
        assert made.webhook.secret.startswith("whsec_")
        assert client.schedules.get(made.id).webhook.secret is None
        later = client.schedules.change(made.model_copy(update={"cron": "30 6 * * 1"}))
        assert (later.cron, later.webhook.url) == ("30 6 * * 1", made.webhook.url)
        with pytest.raises(ConflictingError, match="changed by someone else"):
            client.schedules.change(made)
        assert list(client.schedules.deliveries(made.id)) == []
        client.schedules.remove(made.id)
        assert [s.id for s in client.schedules.list(ids["rig_id"])] == [ids["schedule_id"]]
        rig = client.rigs.get(ids["rig_id"])
        assert client.rigs.choose_baseline(rig, model.id).baseline_model == model.id
        assert [v.version for v in client.rigs.versions(rig.id)] == [1]
        spare = client.rigs.create(rig.datasheet, name="spare")
        client.rigs.retire(spare.id)
        assert client.rigs.get(spare.id).retired_at is not None
        done = client.jobs.get(ids["job_id"])
        result = {"model": model.id, "gap": ids["gap_id"], "health": ids["health_id"], "experiment": done.experiment}
        files = client.save(done.model_copy(update={"result": result}), tmp_path / "out")
        wanted = {"experiment.h5", "rig.toml", "result.json", "report.html", "gap.json", "gap.html"}
        assert {p.name for p in files.values()} == wanted | {"health.json", "health.html"}


def test_everything_that_is_sent_or_answered_has_an_example(described):
    service, _, _ = described
    document = httpx.get(f"{service.url}/openapi.json").json()
    shapes = document["components"]["schemas"]

    def shown(schema: dict) -> bool:
        schema = shapes[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema
        if "examples" in schema or "example" in schema or "const" in schema:
            return True
        if "oneOf" in schema or "anyOf" in schema:
            return any(shown(s) for s in schema.get("oneOf", schema.get("anyOf")))
        if schema.get("type") == "array":
            return shown(schema["items"])
        fields = schema.get("properties", {})
        return shown(fields["items"]) if set(fields) == {"items", "next"} else False

    silent = [
        f"{method} {path} {where}"
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        for where, part in [("body", operation.get("requestBody", {})), *operation["responses"].items()]
        for kind, content in part.get("content", {}).items()
        if kind.endswith("json") and "example" not in content and "examples" not in content
        if not shown(content.get("schema", {}))
    ]
    assert silent == []


def test_examples_of_a_models_documents_have_what_the_documents_have(described):
    service, key, ids = described
    paths = httpx.get(f"{service.url}/openapi.json").json()["paths"]
    seen = 0
    for path in (p for p in paths if p.startswith("/api/v1/models/{model_id}/")):
        operation = paths[path]["get"]
        example = operation["responses"]["200"]["content"].get("application/json", {}).get("example")
        if example is None:
            continue
        url = service.url + path.format(**ids)
        asked = {"format": "json"} if "format" in [p["name"] for p in operation["parameters"]] else {}
        answer = httpx.get(url, params=asked, headers={"Authorization": f"Bearer {key}"})
        assert missing(example, answer.json()) == [], path
        seen += 1
    assert seen == 7


def missing(example: object, real: object, at: str = "") -> list[str]:
    """Names that an example has and the real document lacks."""
    if not isinstance(example, dict):
        return []
    if not isinstance(real, dict):
        return [] if real is None else [at]
    return [
        lost
        for name, value in example.items()
        for lost in ([f"{at}.{name}"] if name not in real else missing(value, real[name], f"{at}.{name}"))
    ]


@pytest.mark.timeout(HANGS_S + 60)
def test_the_api_is_what_its_description_says(described, tmp_path):
    pytest.importorskip("schemathesis", reason="schemathesis is not installed")
    found = tried(*described, tmp_path, EXAMPLES, HANGS_S)
    assert found.passed, found.said
    assert found.whole


@pytest.mark.pg
@pytest.mark.timeout(HANGS_S + 60)
def test_what_changes_something_does_so_on_postgresql_too(tmp_path):
    """Which values can be kept is up to the database."""
    pytest.importorskip("schemathesis", reason="schemathesis is not installed")
    from tests.support.postgres import empty_database

    home = tmp_path / "home"
    home.mkdir()
    with empty_database() as url, serving(Settings(home=home, database_url=url, **UNLIMITED)) as service:
        key = service.key(Scope.admin)
        writing = [part for method in ("POST", "PUT") for part in ("--include-method", method)]
        found = tried(service, key, filled(service, key, home), tmp_path, EXAMPLES, HANGS_S, *writing)
    assert found.passed, found.said
