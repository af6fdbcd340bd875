"""The worker beside `ambit serve`: its settings come on stdin, and it ends when stdin does."""

from __future__ import annotations

import sys

from service import logs, tracing
from service.bootstrap import product_version
from service.config import Settings
from service.jobs.worker import serve
from service.remarks import one_line, say
from sim.errors import AmbError


def main() -> None:
    """Be the worker."""
    settings = Settings.model_validate_json(sys.stdin.buffer.readline())
    logs.configure(settings.log_level, settings.log_format)
    tracing.configure(settings.otlp_endpoint, "ambit-worker", product_version())
    try:
        serve(settings, end_with_stdin=True)
    except AmbError as error:
        say(f"ambit worker: {one_line(str(error))}")
        sys.exit(1)


if __name__ == "__main__":
    main()
