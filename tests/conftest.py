"""What holds for every test."""

import sys
import threading
from collections.abc import Generator

import pytest
from hypothesis import settings

settings.register_profile("ambit", deadline=None)  # a machine may stall; timings are benchmarks
settings.load_profile("ambit")

LONG = tuple(f"tests/{folder}/" for folder in ("e2e", "integration", "unit/service/gap", "unit/service/identification"))
"""Folders whose modules take longest."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest comes first: a long module that is begun last leaves the other workers idle.

    pytest-xdist would begin with the modules of most tests, and those that take longest have few.
    """
    items.sort(key=lambda item: not item.nodeid.startswith(LONG))


def _untraced(item: pytest.Item) -> Generator[None]:
    if not item.get_closest_marker("no_cover"):
        return (yield)
    tracer, of_threads = sys.gettrace(), threading.gettrace()
    sys.settrace(None)
    threading.settrace(None)
    try:
        return (yield)
    finally:
        sys.settrace(tracer)
        threading.settrace(of_threads)


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """What a test marked ``no_cover`` sets up is not traced either."""
    return (yield from _untraced(item))


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Pause the tracer that is left: pytest-cov pauses one, but has another below it in a process of pytest-xdist."""
    return (yield from _untraced(item))
