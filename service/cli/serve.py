"""``ambit serve`` and ``ambit worker``: the API, and who does the jobs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from service.cli.installation import Config, Home
from service.remarks import say

Traces = Annotated[str | None, typer.Option(help="Where OpenTelemetry traces go, http://collector:4318.")]


def serve(
    config: Config = None,
    home: Home = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port; 0 takes a free one.", min=0, max=65535)] = None,
    certificate: Annotated[Path | None, typer.Option(help="TLS certificate, PEM.")] = None,
    key: Annotated[Path | None, typer.Option(help="Its key, PEM.")] = None,
    otlp_endpoint: Traces = None,
    worker: Annotated[bool, typer.Option(help="Also work on jobs, in a process beside.")] = True,
) -> None:
    """Serve the API, and work on jobs, until Ctrl-C; prints the URL when it is ready."""
    from service import logs, tracing
    from service.api.server import end_without_threads, prepared
    from service.bootstrap import product_version
    from service.config import load
    from service.jobs.supervisor import Supervisor

    tls = {"tls_certificate": certificate, "tls_key": key}
    flags = {"home": home, "host": host, "port": port, "otlp_endpoint": otlp_endpoint, **tls}
    settings = load(config, flags=flags)
    logs.configure(settings.log_level, settings.log_format)
    tracing.configure(settings.otlp_endpoint, "ambit-api", product_version())
    server, notice = prepared(settings)
    if notice:
        say(f"ambit serve: {notice}")
    supervisor = Supervisor(settings) if worker else None
    if supervisor is not None:
        supervisor.start(server.services.database)
    try:
        server.run()
    finally:
        if supervisor is not None:
            supervisor.end()
    end_without_threads()


def worker(
    name: Annotated[
        str | None, typer.Option(help="Stable, and unique among the workers; else the host's name.")
    ] = None,
    config: Config = None,
    home: Home = None,
    otlp_endpoint: Traces = None,
) -> None:
    """Work on jobs until Ctrl-C. Run it under a supervisor that starts it again under the same name."""
    from service import logs, tracing
    from service.bootstrap import product_version
    from service.config import load
    from service.jobs.worker import serve as work

    settings = load(config, flags={"home": home, "worker_name": name, "otlp_endpoint": otlp_endpoint})
    logs.configure(settings.log_level, settings.log_format)
    tracing.configure(settings.otlp_endpoint, "ambit-worker", product_version())
    work(settings)
