"""Percent and time left of a job, as whoever waits for it relies on them."""

from itertools import pairwise

import pytest

from service.jobs.progress import MEASURING, WHOLE, Part


class Job:
    """What a job would be told, and a clock."""

    def __init__(self) -> None:
        self.told = []
        self.at = 0.0

    def report(self, **values) -> None:
        self.told.append(values)

    def clock(self) -> float:
        return self.at


@pytest.fixture
def job():
    return Job()


def test_percent_rises_with_every_point_when_the_plan_grows_on_the_way(job):
    part = Part(job, MEASURING, job.clock)
    for done in range(1, 101):
        part.points("main", done, 100 if done < 60 else 160, None)
    for done in range(101, 161):
        part.points("peaks", done, 160, None)
    percents = [t["percent"] for t in job.told]
    assert all(b > a for a, b in pairwise(percents))
    assert percents[9] == pytest.approx(8.0)
    assert percents[-1] == pytest.approx(80.0)


def test_points_that_are_told_again_after_an_interruption_change_nothing(job):
    part = Part(job, WHOLE, job.clock)
    for done in (1, 2, 3, 4, 1, 2, 3, 4, 5):
        part.points("main", done, 10, None)
    assert [t["percent"] for t in job.told] == pytest.approx([10, 20, 30, 40, 40, 40, 40, 40, 50])


def test_time_left_follows_from_the_pace_and_is_unknown_before_there_is_one(job):
    part = Part(job, WHOLE, job.clock)
    part.tell("identification", 2.0)
    assert job.told[-1]["time_left_s"] is None
    job.at = 10.0
    part.tell("identification", 51.0)
    assert job.told[-1]["time_left_s"] == pytest.approx(10.0)


def test_what_comes_after_a_step_is_in_the_time_left(job):
    part = Part(job, (0.0, 80.0), job.clock)
    part.points("main", 1, 81, None)
    job.at = 40.0
    part.points("main", 41, 81, 40.0)
    assert job.told[-1]["time_left_s"] == pytest.approx(40.0 + 80.0 * 20 / 80)
    job.at = 80.0
    part.points("done", 81, 81, None)
    assert job.told[-1]["time_left_s"] == pytest.approx(20.0)


def test_no_running_job_is_at_a_hundred_percent(job):
    Part(job, WHOLE, job.clock).points("done", 5, 5, None)
    assert job.told[-1]["percent"] == 99.0
