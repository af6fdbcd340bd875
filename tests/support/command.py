"""The command ``ambit`` as a user runs it, a process of its own; and as good as that in the process of the test."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from unittest.mock import patch

from service import cli

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "COLUMNS": "100", "NO_COLOR": "1"}
AMBIT = [str(Path(sys.executable).with_name("ambit"))]
"""The script that the installation put beside the interpreter."""


def ambit(*arguments: object, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [*AMBIT, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
        timeout=timeout_s,
        check=False,
    )


def at_once(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in this process: to start one takes a second, most of it for what a test has loaded.

    All that the process adds is that it exits with this status.
    """
    out, err = StringIO(), StringIO()
    with patch.dict(os.environ, ENVIRONMENT), redirect_stdout(out), redirect_stderr(err):
        status = cli.run([str(a) for a in arguments])
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def refusal(*arguments: object, status: int = 1) -> str:
    """The one line on stderr of a command that must fail, and nothing on stdout; at once."""
    done = at_once(*arguments)
    assert done.returncode == status, (done.stdout, done.stderr)
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert done.stdout == ""
    return lines[0]


class Running:
    """A command that runs, with what it has said on stderr so far."""

    def __init__(self, *arguments: object) -> None:
        self.process = subprocess.Popen(
            [*AMBIT, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=ENVIRONMENT,
            start_new_session=True,
        )
        self.said: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        self.said.extend(iter(self.process.stderr.readline, ""))

    def first_line(self) -> str:
        """The first line on stdout; empty when the command ends without."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Ctrl-C, which a terminal sends to the command and all of its workers; other signals to the command alone."""
        if number == signal.SIGINT:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)

    def wait(self, timeout_s: float = 60.0) -> int:
        """Exit status, once everything it said is read."""
        status = self.process.wait(timeout_s)
        self._reader.join(timeout_s)
        return status

    def end(self) -> None:
        """Kill, if it still runs, and reap."""
        self.process.kill()
        self.process.wait(20)
        self._reader.join(20)
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self.process.stdout.close()
        self.process.stderr.close()


def wait_until(condition, what: str, seconds: float = 60.0) -> None:
    """Poll until something is true."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} did not come within {seconds} s")
        time.sleep(0.02)
