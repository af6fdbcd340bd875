"""CPU time of a service's processes, and cores that other programs took meanwhile; from /proc, so on Linux only."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import make_url

if TYPE_CHECKING:
    from tests.support.service import Service

_TICKS = os.sysconf("SC_CLK_TCK")
CALCULATION, AROUND = "calculation", "around it"


def _processes() -> dict[int, tuple[str, int, float]]:
    """Command, parent and CPU seconds, with those of children that have ended, of every process."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            command = (entry / "cmdline").read_text().replace("\0", " ")
        except (OSError, ValueError):
            continue
        found[int(entry.name)] = command, int(fields[1]), sum(map(int, fields[11:15])) / _TICKS
    return found


def _busy_s() -> float:
    """CPU seconds of the whole machine."""
    fields = [int(x) for x in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    return (sum(fields[:3]) + sum(fields[5:8])) / _TICKS


class Meter:
    """What a service has used since the meter was made: calculations, and API, workers and PostgreSQL around them."""

    def __init__(self, found: Service) -> None:
        self._service = found
        self._began = time.monotonic()
        self._before, self._busy = self._now(), _busy_s()

    def _now(self) -> dict[str, float]:
        database = make_url(self._service.environment["AMBIT_DATABASE_URL"]).database or ""
        workers = {running.process.pid for running in self._service.workers.values()}
        around = {*workers, os.getpid(), self._service.api.process.pid}
        used = {CALCULATION: 0.0, AROUND: 0.0}
        for pid, (command, parent, seconds) in _processes().items():
            if parent in workers and "service.jobs.calculating" in command:
                used[CALCULATION] += seconds
            elif pid in around or (command.startswith("postgres:") and database in command):
                used[AROUND] += seconds
        return used

    def told(self, jobs: int) -> str:
        """CPU seconds a job, and the cores that other programs took: with them no rate is what the machine gives."""
        used = {name: seconds - self._before[name] for name, seconds in self._now().items()}
        others = (_busy_s() - self._busy - sum(used.values())) / (time.monotonic() - self._began)
        each = " + ".join(f"{seconds / jobs:.3f} s {name}" for name, seconds in used.items())
        return f"CPU a job {each}; other programs took {max(others, 0.0):.2f} cores"
