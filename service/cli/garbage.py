"""Garbage collection of a command that loads and computes much, and makes little garbage."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

SELDOM = 100_000, 20, 20
"""Thresholds of the collector: by Python's own it searches some 400 times while a diagnosis loads and computes, three
times of them through all that is loaded, which takes a tenth of a second each."""


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Have garbage looked for seldom in this block, and in processes that begin in it as copies of this one."""
    before = gc.get_threshold()
    gc.set_threshold(*SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)
