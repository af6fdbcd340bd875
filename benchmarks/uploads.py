"""Hostile uploads: status, seconds from the call to the refusal, and the memory that the largest child took.

``python benchmarks/uploads.py``
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from service.uploads import UploadError, parse
from tests.support.uploads import HOSTILE, good


def main() -> None:
    slowest = 0.0
    print("file                                 bytes  status     s   reason")
    for name, (make, _, _) in {"a good file": (good, 0, ""), **HOSTILE}.items():
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder) / "received")
            began = time.perf_counter()
            try:
                parse(path, "sent.h5", Path(folder) / "understood.h5")
                status, reason = 0, "read"
            except UploadError as error:
                status, reason = error.status, str(error)
            seconds = time.perf_counter() - began
            slowest = max(slowest, seconds)
            print(f"{name:30} {path.stat().st_size:11,d}  {status or 'ok':>6}  {seconds:.2f}   {reason[:120]}")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"slowest {slowest:.2f} s; the largest child took {peak:.0f} MiB, this process {own:.0f} MiB")


if __name__ == "__main__":
    main()
