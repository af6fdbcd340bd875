"""Calculations in processes of their own: they can be stopped at once, and take neither memory nor time from a rig."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

from service.errors import JobError, StoppedError
from service.jobs.calculations import WORDS, Tell, silent

_POLL_S = 0.25
"""With the job's own look for its cancellation, a calculation ends in about a second."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


class _Child:
    def __init__(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "service.jobs.calculating"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **_ONE_THREAD},
            text=True,
            encoding="utf-8",
            start_new_session=True,
        )

    def alive(self) -> bool:
        return self.process.poll() is None

    def kill(self) -> None:
        """End it and whatever it started."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):
                if pipe is not None:
                    pipe.close()

    def ask(self, request: dict[str, Any], stopped: Callable[[], bool], tell: Tell) -> dict[str, Any]:
        stdin, stdout = _pipe(self.process.stdin), _pipe(self.process.stdout).fileno()
        try:
            stdin.write(json.dumps(request) + "\n")
            stdin.flush()
        except BrokenPipeError:
            raise self._lost() from None
        begun = b""
        with selectors.DefaultSelector() as selector:
            selector.register(stdout, selectors.EVENT_READ)
            while True:
                if stopped():
                    raise StoppedError("the calculation was stopped")
                if not selector.select(_POLL_S):
                    continue
                if not (read := os.read(stdout, 65536)):
                    raise self._lost()
                *lines, begun = (begun + read).split(b"\n")
                for line in lines:
                    said: dict[str, Any] = json.loads(line)
                    if "progress" not in said:
                        return said
                    tell(said["progress"]["phase"], said["progress"]["percent"])

    def _lost(self) -> JobError:
        status = self.process.wait()
        reason = f"signal {-status}" if status < 0 else f"status {status}"
        more = ", as when memory runs out" if status == -signal.SIGKILL else ""
        return JobError("calculation ended", f"the process that calculated ended with {reason}{more}; try again")


class Calculator:
    """Children that wait for work, as many as calculated at once so far."""

    def __init__(self) -> None:
        self._idle: list[_Child] = []
        self._lock = threading.Lock()
        self._closed = False

    def warm(self) -> None:
        """Have a child ready before the first job comes."""
        self._give_back(_Child())

    def run(
        self, function: str, arguments: dict[str, Any], stopped: Callable[[], bool], tell: Tell = silent
    ) -> dict[str, Any]:
        """Result of a function of `service.jobs.calculations`.

        Parameters
        ----------
        arguments
            What JSON can say; paths as strings.
        stopped
            Polled four times a second; True ends the child.
        tell
            Told how far it is.

        Raises
        ------
        StoppedError
            ``stopped`` turned true.
        JobError
            The data do not allow it, or the process died.
        """
        child = self._take()
        try:
            answer = child.ask({"function": function, "arguments": arguments}, stopped, tell)
        except BaseException:
            child.kill()
            raise
        self._give_back(child)
        if "error" in answer:
            raise JobError(answer.get("title", f"{WORDS[function]} failed"), answer["error"])
        if "defect" in answer:
            raise JobError(
                "defect of the service",
                f"{WORDS[function]} met an error that is none of the data's ({answer['defect']}); "
                "report it with the log",
            )
        return dict(answer["result"])

    def _take(self) -> _Child:
        with self._lock:
            while self._idle:
                child = self._idle.pop()
                if child.alive():
                    return child
                child.kill()
        return _Child()

    def _give_back(self, child: _Child) -> None:
        with self._lock:
            if not self._closed:
                self._idle.append(child)
                return
        child.kill()

    def close(self) -> None:
        """End the children that wait."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
        for child in idle:
            child.kill()


def _pipe(pipe: IO[str] | None) -> IO[str]:
    assert pipe is not None
    return pipe
