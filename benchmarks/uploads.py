"""Hostile uploads to ``ambit serve``: status and seconds of the answer, and the memory that service and readers took.

``python benchmarks/uploads.py``
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import _one_thread  # noqa: F401  before numpy

sys.path.insert(0, str(Path(__file__).parents[1]))

import httpx

from tests.support.service import Service, reference_sheet, service
from tests.support.uploads import HOSTILE, good, good_matlab

ROW = "{:32} {:>11,d}  {:>6}  {:5.2f}   {}"


def main() -> None:
    files = {
        "a good file": (good, 201, ""),
        "a good MATLAB file": (good_matlab, 201, ""),
        **HOSTILE,
    }
    slowest, wrong = 0.0, []
    with (
        tempfile.TemporaryDirectory() as folder,
        service(Path(folder) / "home", "sqlite", "--no-worker") as running,
        httpx.Client(base_url=running.api.said, timeout=60) as client,
    ):
        rig = running.add_rig(reference_sheet())
        before = high_water_mib(running)
        print(f"{'file':32} {'bytes':>11}  {'status':>6}  {'s':>5}   answer")
        for name, (make, expected, _) in files.items():
            content = make(Path(folder) / "received").read_bytes()
            began = time.perf_counter()
            answer = client.post(
                f"/api/v1/rigs/{rig}/experiments", content=content, headers={"content-type": "application/x-hdf5"}
            )
            seconds = time.perf_counter() - began
            slowest = max(slowest, seconds)
            if answer.status_code != (expected or 201):
                wrong.append(name)
            told = answer.json().get("detail") or "read"
            print(ROW.format(name, len(content), answer.status_code, seconds, told[:110]))
        alive = client.get("/healthz").status_code
        after = high_water_mib(running)
    readers = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"slowest {slowest:.2f} s; wrong: {', '.join(wrong) or 'none'}; /healthz afterwards: {alive}")
    print(f"memory: service {before:.0f} MiB before, {after:.0f} MiB at most; largest process of all {readers:.0f} MiB")


def high_water_mib(running: Service) -> float:
    """Most memory that the API's process ever had."""
    status = Path(f"/proc/{running.api.process.pid}/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) / 1024


if __name__ == "__main__":
    main()
