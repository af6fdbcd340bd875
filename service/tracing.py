"""OpenTelemetry traces, by flag: off, nothing is imported and a span costs nothing; on, they go to a collector.

The libraries are optional: ``pip install 'amb-commissioning[otel]'``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from service.errors import ConfigurationError
from service.logs import HIDDEN, SECRET_NAMES, redacted

_tracer: Any = None
_provider: Any = None


def configure(endpoint: str, service: str, version: str, exporter: Any = None) -> None:
    """Trace this process from now on.

    Parameters
    ----------
    endpoint
        Of the collector, OTLP over HTTP: ``http://collector:4318``; empty turns tracing off.
    service
        Name that the traces carry: ambit-api, ambit-worker.
    version
        Of the product.
    exporter
        Takes the place of the one for ``endpoint``.

    Raises
    ------
    ConfigurationError
        The libraries are not installed.
    """
    global _tracer, _provider
    shutdown()
    if not endpoint:
        return
    try:
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor

        if exporter is None:
            from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter

            exporter = OTLPSpanExporter(endpoint=f"{endpoint.rstrip('/')}/v1/traces")
    except ImportError as error:
        raise ConfigurationError(
            f"traces are asked for with otlp_endpoint, but {error.name} is not installed; "
            "install it with pip install 'amb-commissioning[otel]', or leave otlp_endpoint empty"
        ) from error
    _provider = TracerProvider(resource=Resource.create({"service.name": service, "service.version": version}))
    _provider.add_span_processor(BatchSpanProcessor(exporter))
    _tracer = _provider.get_tracer("ambit", version)


def shutdown() -> None:
    """Send what is left, and trace no more."""
    global _tracer, _provider
    if _provider is not None:
        _provider.shutdown()
    _tracer = _provider = None


@contextmanager
def span(name: str, parent: Mapping[str, str] | None = None, **attributes: str | int | float | bool) -> Iterator[None]:
    """One stretch of work, with its attributes; an error that leaves it is noted.

    Parameters
    ----------
    parent
        Headers (``traceparent``) of whoever asked for the work.

    Examples
    --------
    >>> with span("identify", job="job_1"):
    ...     pass
    """
    if _tracer is None:
        yield
        return
    from opentelemetry.propagate import extract
    from opentelemetry.trace import Status, StatusCode

    shown = {k: HIDDEN if SECRET_NAMES.search(k) else _shown(v) for k, v in attributes.items()}
    context = extract(parent) if parent else None
    with _tracer.start_as_current_span(
        name, context, attributes=shown, record_exception=False, set_status_on_exception=False
    ) as current:
        try:
            yield
        except Exception as error:
            current.set_status(Status(StatusCode.ERROR, redacted(str(error).splitlines()[0] if str(error) else "")))
            current.set_attribute("error.type", type(error).__name__)
            raise


def end(within_s: float = 3.0) -> None:
    """Send what is left before a process ends at once; a collector that is away is not waited for."""
    last = threading.Thread(target=shutdown, name="last-spans", daemon=True)
    last.start()
    last.join(within_s)


def headers() -> dict[str, str]:
    """``traceparent`` of the span that is open here, to hand to whoever does the work; empty when nothing is traced."""
    carrier: dict[str, str] = {}
    if _tracer is not None:
        from opentelemetry.propagate import inject

        inject(carrier)
    return carrier


class TraceRequests:
    """ASGI middleware: one span a request. Add it only when tracing is on.

    Parameters
    ----------
    app
        The application.
    """

    def __init__(self, app: Callable[..., Any]) -> None:
        self._app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """One request."""
        if scope["type"] != "http" or _tracer is None:
            await self._app(scope, receive, send)
            return
        given = {k.decode("latin-1").lower(): v.decode("latin-1") for k, v in scope["headers"]}
        with span(f"{scope['method']} {scope['path']}", {k: v for k, v in given.items() if k == "traceparent"}):
            from opentelemetry import trace

            current = trace.get_current_span()

            async def noted(message: Any) -> None:
                if message["type"] == "http.response.start":
                    current.set_attribute("http.response.status_code", message["status"])
                await send(message)

            await self._app(scope, receive, noted)
            if (route := scope.get("route")) is not None and hasattr(route, "path"):
                current.update_name(f"{scope['method']} {route.path}")


def _shown(value: str | int | float | bool) -> str | int | float | bool:
    return redacted(value) if isinstance(value, str) else value
