"""What is marked as untraced is: half of the tests' time would go to a tracer."""

import subprocess
import sys
import threading

import pytest

from tests.support.processes import ENVIRONMENT, environment


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


def of_a_child() -> bool:
    asked = "import os; print('COVERAGE_PROCESS_CONFIG' in os.environ)"
    done = subprocess.run([sys.executable, "-c", asked], env=environment(ENVIRONMENT), capture_output=True, text=True)
    return done.stdout.strip() == "True"


@pytest.mark.no_cover
def test_processes_and_threads_of_a_marked_test_run_without_a_tracer() -> None:
    assert not of_a_child()
    assert threading.gettrace() is None


def test_those_of_the_next_one_are_traced_again(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("cov_source", None):
        pytest.skip("nothing is traced in this run")
    assert of_a_child()
    assert threading.gettrace() is not None
