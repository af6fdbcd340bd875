"""Keeps a worker running beside the API, in a process of its own: calculations take no time from requests."""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
import time
from contextlib import suppress
from datetime import datetime, timedelta

from service.config import Settings
from service.errors import ConflictError
from service.storage import workers
from service.storage.clock import told
from service.storage.database import Database

log = logging.getLogger(__name__)

FIRST_PAUSE_S = 1.0
"""Before a worker that died is started again; it doubles up to a minute while it keeps dying."""
LONGEST_PAUSE_S = 60.0
GRACE_S = 15.0
ENDING = timedelta(seconds=1)
"""A worker may be heard for so long after its service was killed."""


class Supervisor:
    """A worker that is started again whenever it dies, and ends with this process, however that ends."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="worker-supervisor", daemon=True)

    def start(self, database: Database) -> None:
        """Start the worker.

        Parameters
        ----------
        database
            The one that this process has already: a second one of the same SQLite file would, as it is closed, take
            the locks of the first one along.

        Raises
        ------
        ConflictError
            Another one of its name is at work: this one would be started again and again, and never begin.
        """
        self._must_be_alone(database)
        self._process = self._started()
        self._thread.start()

    def _must_be_alone(self, database: Database) -> None:
        """One that is about to end, as its service was killed, is waited for: it gives no sign of life any more."""
        began: datetime | None = None
        while True:
            with database.read() as session:
                began = began or told(session)
                other = workers.named(session, self._settings.worker)
            if other is None:
                return
            if other.beat_at > began + ENDING:
                raise ConflictError(
                    f"a worker named {other.name!r} runs on {other.machine} as process {other.process} already, "
                    "perhaps that of another ambit serve; end that, give another home, or serve with --no-worker"
                )
            time.sleep(0.1)

    def _started(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", "service.jobs.supervised"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # not by argument: passwords of databases would be seen by all
            process.stdin.write(self._settings.model_dump_json().encode() + b"\n")
            process.stdin.flush()
        return process

    def _watch(self) -> None:
        pause, began = FIRST_PAUSE_S, time.monotonic()
        while not self._over.wait(0.2):
            assert self._process is not None
            if self._process.poll() is None:
                continue
            if time.monotonic() - began > LONGEST_PAUSE_S:
                pause = FIRST_PAUSE_S
            log.error("the worker ended with %d; it is started again in %g s", self._process.returncode, pause)
            if self._over.wait(pause):
                return
            pause, began = min(2 * pause, LONGEST_PAUSE_S), time.monotonic()
            self._process = self._started()

    def end(self) -> None:
        """End the worker: it stops its rigs first."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
        process = self._process
        if process is None:
            return
        process.terminate()
        try:
            process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
