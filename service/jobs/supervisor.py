"""Keeps a worker running beside the API, in a process of its own: calculations take no time from requests."""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
import time
from contextlib import suppress

from service.config import Settings

log = logging.getLogger(__name__)

FIRST_PAUSE_S = 1.0
"""Before a worker that died is started again; it doubles up to a minute while it keeps dying."""
LONGEST_PAUSE_S = 60.0
GRACE_S = 15.0


class Supervisor:
    """A worker that is started again whenever it dies, and ends with this process, however that ends."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="worker-supervisor", daemon=True)

    def start(self) -> None:
        """Start the worker."""
        self._process = self._started()
        self._thread.start()

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
