"""From a request to what its job did: one id in the logs of both processes, one trace, and nothing lost at the end."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.support.service import reference_sheet, service
from tests.support.uploads import good


@pytest.fixture
def collector():
    """Address of a collector, and the bodies that it got."""
    arrived: list[bytes] = []

    class Collector(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            arrived.append(self.rfile.read(int(self.headers["content-length"])))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Collector) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", arrived
        server.shutdown()
        thread.join()


def test_a_job_is_joined_to_the_request_that_asked_for_it(tmp_path, collector):
    messages = pytest.importorskip("opentelemetry.proto.collector.trace.v1.trace_service_pb2", reason="no OTLP here")
    address, arrived = collector
    with service(tmp_path / "home", "sqlite", "--no-worker", "--otlp-endpoint", address) as running:
        running.environment["AMBIT_OTLP_ENDPOINT"] = address
        worker = running.worker("w1")
        rig = running.add_rig(reference_sheet(), name="bench")
        experiment = running.upload(rig, good(tmp_path / "e.h5"))
        asked = {"kind": "identification", "rig": rig, "experiment": experiment}
        job = running.post("/jobs", asked, headers={"X-Request-Id": "from-the-desk"})["id"]
        running.client.post("/api/v1/jobs", json={**asked, "rig": "rig_0"}, headers={"X-Request-Id": "refused"})
        running.wait(job)
        assert worker.interrupt() == 0
    said = "".join(path.read_text() for path in (tmp_path / "home").glob("*.log")).splitlines()
    lines = [json.loads(line) for line in said if line.startswith("{")]
    assert not any("color_message" in line for line in lines)
    of_request = [line for line in lines if line.get("request") == "from-the-desk"]
    assert {line["logger"] for line in of_request if line.get("job") == job} >= {
        "service.api.middleware",
        "service.jobs.steps",
    }
    (told,) = [line for line in of_request if line["logger"] == "service.api.middleware"]
    assert told["message"].startswith("POST /api/v1/jobs 202")
    assert (told["rig"], told["level"]) == (rig, "info")
    assert [line["message"][:21] for line in lines if line.get("request") == "refused"] == ["POST /api/v1/jobs 404"]

    spans = [
        span
        for body in arrived
        for resource in messages.ExportTraceServiceRequest.FromString(body).resource_spans
        for scope in resource.scope_spans
        for span in scope.spans
    ]
    (worked,) = [span for span in spans if span.name == "job.identification"]
    requests = {span.span_id: span.name for span in spans}
    assert requests[worked.parent_span_id] == "POST /api/v1/jobs"
