"""What is marked as untraced is: half of the tests' time would go to a tracer."""

import sys
import threading

import pytest


@pytest.fixture
def tracer_of_setup() -> object:
    return sys.gettrace()


@pytest.mark.no_cover
def test_a_marked_test_and_what_it_sets_up_run_without_a_tracer(tracer_of_setup: object) -> None:
    assert tracer_of_setup is None
    assert sys.gettrace() is None


def test_the_next_one_is_traced_again(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("cov_source", None):
        pytest.skip("nothing is traced in this run")
    assert sys.gettrace() is not None


@pytest.mark.no_cover
def test_threads_of_a_marked_test_run_without_a_tracer() -> None:
    assert threading.gettrace() is None


def test_those_of_the_next_one_are_traced_again(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("cov_source", None):
        pytest.skip("nothing is traced in this run")
    assert threading.gettrace() is not None
