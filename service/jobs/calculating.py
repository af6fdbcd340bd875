"""The child process that calculates: reads one request a line, writes lines of progress and then one with the answer.

Run as ``python -m service.jobs.calculating``. It ends when its parent does, and so do processes that it starts.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

from service.errors import JobError
from service.jobs import calculations, slices
from sim.errors import AmbError

_NICE = 10
"""Rigs and requests come first."""
_PR_SET_PDEATHSIG = 1
FIRST_NEEDED = ("service.identification.fit", "service.report.commissioning", "service.report.curves")
"""Loaded while the child waits, so that the first identification begins at once."""


def main() -> None:
    """Answer requests until there are no more."""
    _end_with_parent()
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    slices.lengthen()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is no answer
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in FIRST_NEEDED:
        import_module(name)

    def say(message: dict[str, Any]) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    def tell(phase: str, percent: float) -> None:
        say({"progress": {"phase": phase, "percent": percent}})

    for request in sys.stdin:
        say(_answer(json.loads(request), tell))


def _answer(request: dict[str, Any], tell: calculations.Tell) -> dict[str, Any]:
    function: Callable[..., dict[str, Any]] = calculations.BY_NAME[request["function"]]
    try:
        return {"result": function(**request["arguments"], tell=tell)}
    except JobError as error:
        return {"error": str(error), "title": error.title}
    except AmbError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "the calculation needs more memory than there is; give the worker more, or less data"}
    except Exception as error:  # a defect of ours is told, and does not end the worker
        import traceback

        traceback.print_exc(file=sys.stderr)
        return {"defect": f"{type(error).__name__}: {error}"}


def _end_with_parent() -> None:
    """On Linux, die with the parent; elsewhere the end of stdin does it when the calculation is over."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    main()
elif __name__ == "__mp_main__":  # a process that this one has started, to calculate beside it
    _end_with_parent()
