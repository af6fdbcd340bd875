"""What holds for every test."""

import sys
from collections.abc import Generator

import pytest


def _untraced(item: pytest.Item) -> Generator[None]:
    tracer = sys.gettrace()
    if item.get_closest_marker("no_cover"):
        sys.settrace(None)
    try:
        return (yield)
    finally:
        sys.settrace(tracer)


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """What a test marked ``no_cover`` sets up is not traced either."""
    return (yield from _untraced(item))


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Pause the tracer that is left: pytest-cov pauses one, but has another below it in a process of pytest-xdist."""
    return (yield from _untraced(item))
