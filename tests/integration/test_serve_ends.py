"""``ambit serve`` ends when it is told to, whatever hangs; and a second one on the same home does not begin."""

import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager

import httpx

from service.api.app import THREADS
from service.storage import workers
from service.storage.database import Database
from tests.support.processes import ENVIRONMENT, ROOT, wait_for

HANGS = """
import os, sys, threading
from service.storage import rigs
rigs.listed = lambda *_: (os.write(1, b"hangs\\n"), threading.Event().wait())
from service.cli import main
main(sys.argv[1:])
"""
"""A service whose list of rigs never comes back, as from a disk that has gone."""
PLAIN = "import sys; from service.cli import main; main(sys.argv[1:])"


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
            env=ENVIRONMENT,
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
    with started(tmp_path, "--no-worker") as (process, url), ThreadPoolExecutor(THREADS) as callers:
        asked = [callers.submit(httpx.get, f"{url}/api/v1/rigs", timeout=60) for _ in range(THREADS)]
        for _ in asked:
            assert process.stdout.readline().strip() == "hangs"
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        answers = [call.result() for call in asked]
    assert {answer.status_code for answer in answers} == {503}
    assert "the service ends" in answers[0].json()["detail"]
    log = (tmp_path / "log").read_text()
    assert "Traceback" not in log


def working(home) -> bool:
    """Whether a worker has signed on and lives."""
    with closing(Database(f"sqlite:///{home / 'ambit.db'}")) as database, database.read() as session:
        return bool(workers.living(session))


def test_a_second_service_on_the_same_home_ends_at_once_with_one_line(tmp_path):
    with started(tmp_path, script=PLAIN) as (first, url):
        assert url
        wait_for(lambda: working(tmp_path / "home"), "the worker to sign on", 60)
        before = len((tmp_path / "log").read_text())
        with started(tmp_path, script=PLAIN) as (second, said):
            assert said == ""  # no URL that seems to be served
            assert second.wait(20) == 1
        said = (tmp_path / "log").read_text()[before:]
        assert re.search(r"^ambit: a worker named '.*' runs on .* as process \d+ already.* --no-worker$", said, re.M)
        assert "Traceback" not in said
        assert first.poll() is None
        with started(tmp_path, "--no-worker", script=PLAIN) as (_, third):
            assert httpx.get(f"{third}/api/v1/rigs").status_code == 200
        first.kill()
        first.wait(20)
        with started(tmp_path, script=PLAIN) as (_, again):  # its worker is ending yet
            assert httpx.get(f"{again}/api/v1/rigs").status_code == 200
            wait_for(lambda: working(tmp_path / "home"), "the worker to sign on", 60)
