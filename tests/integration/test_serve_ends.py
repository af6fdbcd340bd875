"""``ambit serve`` ends when it is told to, whatever hangs; and a second one on the same home does not begin."""

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import httpx
import pytest

from service.api.app import THREADS
from tests.support.processes import ENVIRONMENT, ROOT, environment

pytestmark = pytest.mark.no_cover

HANGS = """
import sys, threading
from service.storage import rigs
rigs.listed = lambda *_: threading.Event().wait()
from service.cli import main
main(sys.argv[1:])
"""
"""A service whose list of rigs never comes back, as from a disk that has gone."""


@contextmanager
def started(tmp_path, *arguments, script=HANGS):
    """A service and its URL; its log is in a file."""
    command = [sys.executable, "-c", script, "serve", "--home", tmp_path / "home", "--port", "0", *arguments]
    with (tmp_path / "log").open("ab") as log:
        process = subprocess.Popen(
            [*map(str, command)],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env=environment(ENVIRONMENT, traced=False),
            cwd=ROOT,
        )
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait(20)
        process.stdout.close()


def test_a_service_ends_though_its_requests_hang_and_tells_no_defect(tmp_path):
    with started(tmp_path, "--no-worker") as (process, url), ThreadPoolExecutor(2 * THREADS) as callers:
        asked = [callers.submit(httpx.get, f"{url}/api/v1/rigs", timeout=40) for _ in range(2 * THREADS)]
        time.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        answers = [call.result() for call in asked]
    assert {answer.status_code for answer in answers} == {503}
    assert "the service ends" in answers[0].json()["detail"]
    log = (tmp_path / "log").read_text()
    assert "Traceback" not in log
