"""Processes that calculate beside a command, and end without a word when the user or the command ends."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import forkserver, get_context, resource_tracker
from types import TracebackType
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_INTERRUPTED = 130
_ENDS = (signal.SIGINT,)


def prepare(*modules: str) -> None:
    """Load ``modules`` once, in the process that those of all pools begin as copies of, beside what goes on here.

    What they import takes seconds; where nobody says it in advance, every process loads for itself. Only the first call
    in a process counts.
    """
    forkserver.set_forkserver_preload(["__main__", *modules])
    with _ctrl_c_held_back():
        forkserver.ensure_running()


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """What is started in here begins with Ctrl-C held back, as it inherits the mask of the thread that starts it."""
    resource_tracker.ensure_running()  # which ends with the signal let through, were it started below
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Workers(ProcessPoolExecutor):
    """A pool that is left at once where an error or Ctrl-C ends its block."""

    def __init__(self, jobs: int) -> None:
        # Copies of a process that has only loaded: those of this one would inherit locks of its threads.
        super().__init__(jobs, mp_context=get_context("forkserver"), initializer=_end_when_asked)

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """As any pool's; a process that is started for it is known to the pool before Ctrl-C is heard."""
        with _ctrl_c_held_back():
            return super().submit(function, *args, **kwargs)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for what runs; where the command is on its way out, kill it, as it may take minutes yet."""
        if kind is not None:
            for process in list((self._processes or {}).values()):
                process.kill()
        self.shutdown(cancel_futures=True)


def workers(jobs: int) -> Workers:
    """``jobs`` processes, each started as soon as work for it comes; `prepare` says what they have loaded then.

    Ctrl-C reaches every process of a terminal: until a worker can answer it by ending at once, it holds the signal
    back, also while Python itself loads. A worker whose command is gone ends, too.
    """
    return Workers(jobs)


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
