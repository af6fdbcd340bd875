"""Calculations in a process of their own: refused data, a stop, a child that dies, none left behind."""

import json
import os
import signal
import threading
import time

import pytest

from service.errors import JobError, StoppedError
from service.experiment import file
from service.jobs.calculator import Calculator
from tests.support.commissioned import result
from tests.support.measured import small_experiment


@pytest.fixture(scope="module")
def calculator():
    found = Calculator()
    found.warm()
    yield found
    found.close()


def arguments(folder, experiment):
    from tests.support.service import reference_sheet

    (folder / "rig.toml").write_text(reference_sheet())
    return {"experiment": str(experiment), "rig": str(folder / "rig.toml"), "out": str(folder / "out"), "name": "e"}


def never():
    return False


def test_data_that_do_not_allow_it_are_told_in_one_line(calculator, tmp_path):
    (tmp_path / "e.h5").write_bytes(b"nothing")
    with pytest.raises(JobError, match=r"e\.h5") as error:
        calculator.run("identification", arguments(tmp_path, tmp_path / "e.h5"), never)
    assert error.value.title == "identification failed"
    assert "\n" not in str(error.value)


def test_a_check_that_its_budget_cannot_hold_is_told_as_that(calculator, tmp_path):
    """In words, and not with the name of a function."""
    asked = arguments(tmp_path, tmp_path / "result.json")
    (tmp_path / "result.json").write_text(json.dumps(result()))
    planned = {"baseline": asked["experiment"], "rig": asked["rig"], "budget_s": 25.0}
    with pytest.raises(JobError, match=r"25 s .* budget_s of at least \d+") as error:
        calculator.run("health_plan", planned, never)
    assert error.value.title == "budget too small"
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(JobError, match=r"result\.json") as error:
        calculator.run("health_plan", planned, never)
    assert error.value.title == "planning the check failed"


def test_it_tells_how_far_it_is_before_it_answers(calculator, tmp_path):
    experiment, _ = small_experiment("x")
    file.write(tmp_path / "e.h5", experiment)
    said = []
    asked = arguments(tmp_path, tmp_path / "e.h5")
    answer = calculator.run("identification", asked, never, lambda phase, percent: said.append((phase, percent)))
    phases, percents = zip(*said, strict=True)
    assert list(dict.fromkeys(phases)) == ["identification", "report"]
    assert phases.count("identification") > 2, "a long identification tells more than its begin"
    assert percents[0] > 0
    assert percents[-1] < 100
    assert list(percents) == sorted(set(percents))
    assert set(answer["planes"]) == {"x"}


@pytest.fixture
def endless(tmp_path):
    """Arguments of a calculation that waits for ever."""
    stalled = tmp_path / "stalled"
    os.mkfifo(stalled)
    return {"baseline": str(stalled), "rig": str(stalled), "budget_s": 1}


def test_a_stop_ends_the_calculation_at_once_and_the_next_one_runs(calculator, endless, tmp_path):
    began = time.monotonic()
    with pytest.raises(StoppedError):
        calculator.run("health_plan", endless, lambda: time.monotonic() - began > 0.3)
    with pytest.raises(JobError, match="missing"):
        calculator.run("identification", arguments(tmp_path, tmp_path / "missing.h5"), never)


def test_a_child_that_dies_is_a_job_that_failed(calculator, endless):
    child = calculator._take()
    calculator._give_back(child)

    def kill():
        time.sleep(0.2)
        os.kill(child.process.pid, signal.SIGKILL)

    threading.Thread(target=kill).start()
    with pytest.raises(JobError, match="signal 9") as error:
        calculator.run("health_plan", endless, never)
    assert error.value.title == "calculation ended"
