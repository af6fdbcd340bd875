"""One identified rig for all tests of the report."""

import pytest

from service.identification.fit import identify
from tests.support.measured import small_experiment


@pytest.fixture(scope="package")
def measured():
    """Experiment and datasheet."""
    return small_experiment()


@pytest.fixture(scope="package")
def result(measured):
    return identify(*measured)
