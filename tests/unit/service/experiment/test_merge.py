"""Experiments of one rig at several speeds become one; those of different rigs are refused by name."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.experiment.errors import ExperimentFileError
from service.experiment.merge import merged
from service.report.measurement import sweep_table
from tests.support.measured import small_experiment


def test_sweeps_follow_one_another_and_rig_time_adds_up() -> None:
    first, _ = small_experiment("x")
    first = replace(first, attributes={"rig_seconds": "100", "controller": "a"})
    turning = replace(
        first,
        sweeps=tuple(replace(s, speed_rad_s=150.0) for s in first.sweeps),
        attributes={"rig_seconds": "50.5", "controller": "b"},
    )
    whole = merged([first, turning], ["a.h5", "b.h5"])
    assert [s.speed_rad_s for s in whole.sweeps] == [0.0] * 3 + [150.0] * 3
    assert whole.attributes == {"rig_seconds": "150.5", "controller": "a"}
    assert merged([first], ["a.h5"]).sweeps == first.sweeps


@pytest.mark.parametrize("told", ["1503.2 s", "nan", "-inf", "-3", "", None])
def test_a_time_on_the_rig_that_one_file_does_not_tell_is_not_known_of_all(told: str | None) -> None:
    """As of a file that another program wrote: the sum of the others would be told as the time of all."""
    first, _ = small_experiment("x")
    known = replace(first, attributes={"rig_seconds": "100", "controller": "a"})
    other = replace(first, attributes={} if told is None else {"rig_seconds": told})
    for experiments in ([known, other], [other, known], [other, other]):
        whole = merged(experiments, ["a.h5", "b.h5"])
        assert whole.rig_seconds is None
        assert "rig_seconds" not in whole.attributes
    assert known.rig_seconds == 100.0


def timed(experiment: Experiment, minutes: list[float]) -> Experiment:
    """The experiment with its sweeps measured one after another, each for so long; a file's clock starts at 0."""
    sweeps, begin = [], 0.0
    for s, each in zip(experiment.sweeps, minutes, strict=True):
        sweeps.append(replace(s, time_s=begin + 60.0 * each * np.arange(1, s.n_points + 1) / s.n_points))
        begin += 60.0 * each
    return replace(experiment, sweeps=tuple(sweeps))


def test_each_sweep_of_each_file_keeps_its_own_time_on_the_rig() -> None:
    first, _ = small_experiment("x")
    still, turning = timed(first, [10.0, 5.0, 2.0]), timed(first, [7.0, 4.0, 3.0])
    told = re.findall(r">(\d+) min 00 s<", sweep_table(merged([still, first, turning], ["a.h5", "b.h5", "c.h5"])))
    assert told == ["10", "5", "2", "7", "4", "3"], "a file that does not tell has none, and takes none from the others"


def test_another_rig_is_refused() -> None:
    first, _ = small_experiment("x")
    with pytest.raises(ExperimentFileError, match=r"b\.h5 is of rig 'other'.*give experiments of one rig"):
        merged([first, replace(first, rig="other")], ["a.h5", "b.h5"])
