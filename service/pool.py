"""Processes that calculate beside a command, and end without a word when the user ends it."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess

_INTERRUPTED = 130
_ENDS = (signal.SIGINT,)


class _Process(SpawnProcess):
    """A process that begins with Ctrl-C held back: a pool starts them one by one, as work comes."""

    def start(self) -> None:
        """Start it; a child inherits the mask of the thread that starts it."""
        resource_tracker.ensure_running()  # which ends with the signal let through, were it started below
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    # Spawned, because forked ones would inherit locks of the compiled code's threads.
    Process = _Process


def workers(jobs: int) -> ProcessPoolExecutor:
    """``jobs`` processes, the first started at once and every other one as soon as work for it comes.

    Ctrl-C reaches every process of a terminal: until a worker can answer it by ending at once, it holds the signal
    back, also while Python itself loads.
    """
    pool = ProcessPoolExecutor(jobs, mp_context=_Context(), initializer=_end_when_asked)
    pool.submit(os.getpid)
    return pool


def _end_when_asked() -> None:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # a service's calculations outlive its terminal
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDS)
