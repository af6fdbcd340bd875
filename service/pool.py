"""Processes that calculate beside a command, and end without a word when the user or the command ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from types import TracebackType

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


class Workers(ProcessPoolExecutor):
    """A pool that is left at once where an error or Ctrl-C ends its block."""

    def __init__(self, jobs: int) -> None:
        super().__init__(jobs, mp_context=_Context(), initializer=_end_when_asked)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for what runs; where the command is on its way out, kill it, as it may take minutes yet."""
        if kind is not None:
            for process in list((self._processes or {}).values()):
                process.kill()
        self.shutdown(cancel_futures=True)


def workers(jobs: int) -> Workers:
    """``jobs`` processes, the first started at once and every other one as soon as work for it comes.

    Ctrl-C reaches every process of a terminal: until a worker can answer it by ending at once, it holds the signal
    back, also while Python itself loads. A worker whose command is gone ends, too.
    """
    pool = Workers(jobs)
    pool.submit(os.getpid)
    return pool


def _end_when_asked() -> None:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # a service's calculations outlive its terminal
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDS)
    threading.Thread(target=_end_with_the_command, daemon=True).start()


def _end_with_the_command() -> None:
    # A worker that waits for work holds both ends of the pipe to it: it would never hear that the command was killed.
    if (command := multiprocessing.parent_process()) is not None:
        command.join()
        os._exit(_INTERRUPTED)
