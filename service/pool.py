"""Processes that calculate beside a command, and end without a word when the user ends it."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

_INTERRUPTED = 130
_ENDS = (signal.SIGINT,)


def workers(jobs: int) -> ProcessPoolExecutor:
    """``jobs`` processes, started at once.

    Spawned, because forked ones would inherit locks of the compiled code's threads. Ctrl-C reaches every process of a
    terminal: until a worker can answer it by ending at once, it holds the signal back, also while Python itself loads.
    """
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_end_when_asked)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)  # a child inherits it
    try:
        pool.submit(os.getpid)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return pool


def _end_when_asked() -> None:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # a service's calculations outlive its terminal
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDS)
