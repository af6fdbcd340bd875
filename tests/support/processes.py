"""Device and host as processes of their own, so that they can be killed for real."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
ROOT = Path(__file__).parents[2]


class Process:
    """A Python process whose first line of output says that it is ready."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.PIPE, env=ENVIRONMENT, cwd=ROOT, text=True
        )
        assert self._process.stdout is not None
        self.said = self._process.stdout.readline().strip()
        if not self.said:
            self.end()
            raise RuntimeError(f"{arguments} said nothing")

    def kill(self, number: int = signal.SIGKILL) -> float:
        """Monotonic time at which the signal was sent."""
        at = time.monotonic()
        self._process.send_signal(number)
        return at

    def wait(self) -> int:
        return self._process.wait(timeout=20)

    def end(self) -> None:
        """Kill, if it still runs, and reap."""
        self._process.kill()
        self._process.wait(timeout=20)
        if self._process.stdout:
            self._process.stdout.close()


def device(folder: Path, *arguments: str) -> tuple[Process, Path]:
    """A device process, and the file of its events."""
    events = folder / "events.jsonl"
    events.touch()
    return Process("-m", "drivers.device", "--events", str(events), *arguments), events


def read_events(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def wait_for(condition: Callable[[], object], what: str, seconds: float = 15.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} did not happen within {seconds} s")
        time.sleep(0.002)
