"""What holds for every test."""

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
