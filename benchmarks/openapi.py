"""Whether the API is what its description says, asked with many random requests of every operation.

``python benchmarks/openapi.py [--examples 100] [--database sqlite|postgresql]``; schemathesis makes the requests, right
and wrong ones, for a service that has one of everything. No answer may be an error of the service (5xx), nor a status,
header, type or body that nobody announced.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import _one_thread  # noqa: F401  before numpy

sys.path.insert(0, str(Path(__file__).parents[1]))

from service.access.keys import Scope
from service.config import Settings
from tests.support.described import UNLIMITED, filled, tried
from tests.support.serving import serving


def main() -> int:
    """Try the API; the exit status is 1 when it is not what its description says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--examples", type=int, default=100, help="random requests of each operation")
    parser.add_argument("--database", choices=["sqlite", "postgresql"], default="sqlite")
    a = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        settings = {"home": folder / "home", **UNLIMITED}
        settings["home"].mkdir()
        if a.database == "postgresql":
            from tests.support.postgres import empty_database

            settings["database_url"] = stack.enter_context(empty_database())
        service = stack.enter_context(serving(Settings(**settings)))
        key = service.key(Scope.admin)
        ids = filled(service, key, settings["home"])
        began = time.monotonic()
        found = tried(service, key, ids, folder, a.examples, 7200.0)
        took = time.monotonic() - began
    print(f"{a.database}: {found.operations} operations, {found.requests} requests in {took:.0f} s")
    print("every answer is as described, none is a 5xx" if found.passed and found.whole else found.said)
    return 0 if found.passed and found.whole else 1


if __name__ == "__main__":
    sys.exit(main())
