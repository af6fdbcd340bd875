"""Traces come by flag, say what was done and how it ended, and tell no secret; without the flag nothing happens."""

import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from service import tracing
from service.errors import ConfigurationError


@pytest.fixture
def spans():
    memory = pytest.importorskip(
        "opentelemetry.sdk.trace.export.in_memory_span_exporter", reason="opentelemetry-sdk is not installed"
    )
    exporter = memory.InMemorySpanExporter()
    tracing.configure("http://127.0.0.1:4318", "ambit-test", "1", exporter)

    def finished():
        tracing._provider.force_flush()
        return exporter.get_finished_spans()

    yield finished
    tracing.shutdown()


def test_off_by_default():
    tracing.configure("", "ambit-test", "1")
    with tracing.span("identify", job="job_1"):
        assert tracing.headers() == {}


def test_spans_nest_and_carry_ids(spans):
    with tracing.span("job", job="job_1", rig="rig_1"), tracing.span("point", hz=12.5):
        pass
    point, job = spans()
    assert (job.name, dict(job.attributes)) == ("job", {"job": "job_1", "rig": "rig_1"})
    assert point.parent.span_id == job.context.span_id
    assert job.resource.attributes["service.name"] == "ambit-test"


def test_work_in_another_process_belongs_to_the_request(spans):
    with tracing.span("request"):
        carried = tracing.headers()
    with tracing.span("job", parent=carried):
        pass
    request, job = spans()
    assert job.context.trace_id == request.context.trace_id


def test_an_error_is_noted_without_its_secret(spans):
    def fails():
        with tracing.span("connect", password="hush"):
            raise RuntimeError("postgresql://ambit:hush@db")

    with pytest.raises(RuntimeError):
        fails()
    (span,) = spans()
    assert span.status.status_code.name == "ERROR"
    assert "hush" not in f"{span.status.description}{dict(span.attributes)}{span.events}"


def test_a_request_is_one_span(spans):
    from fastapi import FastAPI
    from starlette.testclient import TestClient

    app = FastAPI()
    app.add_middleware(tracing.TraceRequests)

    @app.get("/rigs/{rig}")
    def rig(rig: str) -> str:
        return rig

    with TestClient(app) as client:
        client.get("/rigs/7")
    (span,) = spans()
    assert (span.name, span.attributes["http.response.status_code"]) == ("GET /rigs/{rig}", 200)


def test_without_the_libraries_the_flag_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'amb-commissioning\[otel\]'"):
        tracing.configure("http://127.0.0.1:4318", "ambit", "1")


def test_spans_reach_a_collector():
    pytest.importorskip("opentelemetry.exporter.otlp.proto.http", reason="the OTLP exporter is not installed")
    arrived: list[tuple[str, bytes]] = []

    class Collector(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            arrived.append((self.path, self.rfile.read(int(self.headers["content-length"]))))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Collector) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        tracing.configure(f"http://127.0.0.1:{server.server_port}/", "ambit-worker", "1")
        with tracing.span("job.experiment", job="job_1"):
            pass
        tracing.shutdown()
        server.shutdown()
        thread.join()
    assert arrived[0][0] == "/v1/traces"
    assert b"job.experiment" in arrived[0][1]
    assert b"ambit-worker" in arrived[0][1]
