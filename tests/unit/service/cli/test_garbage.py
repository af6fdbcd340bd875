"""A command's thresholds of garbage collection end with it, however it ends."""

import gc

import pytest

from service.cli.garbage import seldom_collected
from sim.errors import AmbError


def test_thresholds_are_higher_inside_and_as_before_after_an_error() -> None:
    before = gc.get_threshold()
    with pytest.raises(AmbError), seldom_collected():
        assert gc.get_threshold() > before
        raise AmbError("it ends so")
    assert gc.get_threshold() == before
