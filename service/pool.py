"""Processes that calculate beside a command, and end without a word when the user or the command ends."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import forkserver, get_context, resource_tracker
from pathlib import Path
from types import FrameType, TracebackType
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_INTERRUPTED = 130
_ENDS = (signal.SIGINT,)


def prepare(*modules: str) -> None:
    """Have ``modules`` loaded once for all processes of a pool that cannot begin as copies of this one.

    What they import takes seconds; where nobody says it in advance, every such process loads for itself. Only the first
    pool in a process counts.
    """
    forkserver.set_forkserver_preload(["__main__", *modules])


@contextmanager
def _ctrl_c_held_back() -> Iterator[None]:
    """Ctrl-C is heard after this block; what is started in it begins with the signal held back.

    That it inherits from the thread that starts it. Another thread of this process may take the signal meanwhile, and
    Python have the main one answer it: so the answer is held back, too.
    """
    resource_tracker.ensure_running()  # which ends with the signal let through, were it started below
    heard: list[tuple[int, FrameType | None]] = []
    answer = signal.getsignal(signal.SIGINT)
    hold = callable(answer) and threading.current_thread() is threading.main_thread()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    if hold:
        signal.signal(signal.SIGINT, lambda number, frame: heard.append((number, frame)))
    try:
        yield
    finally:
        if hold:
            signal.signal(signal.SIGINT, answer)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if heard and callable(answer):
            answer(*heard[0])


class Workers(ProcessPoolExecutor):
    """A pool that is left at once where an error or Ctrl-C ends its block."""

    def __init__(self, jobs: int) -> None:
        # Copies of this process begin at once, with all that it has loaded. Of one with other threads they would
        # inherit locks that nobody opens: then they are copies of a process that has only loaded.
        method = "fork" if _has_one_thread() else "forkserver"
        super().__init__(jobs, mp_context=get_context(method), initializer=_begin)

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
    """``jobs`` processes, started as soon as work comes; they have loaded what this one has, or what `prepare` says.

    Ctrl-C reaches every process of a terminal: until a worker can answer it by ending at once, it holds the signal
    back, also while Python itself loads. A worker whose command is gone ends, too.
    """
    return Workers(jobs)


def _has_one_thread() -> bool:
    """Whether no library has a thread in this process, either; where that cannot be told, it may."""
    tasks = Path("/proc/self/task")
    return tasks.is_dir() and len(list(tasks.iterdir())) == 1


def _begin() -> None:
    gc.freeze()  # what came from the other process is no garbage: to search it costs time, and memory that is shared
    _end_when_asked()


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
