"""Experiments of one rig at several speeds become one; those of different rigs are refused by name."""

from __future__ import annotations

from dataclasses import replace

import pytest

from service.experiment.errors import ExperimentFileError
from service.experiment.merge import merged
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


def test_another_rig_is_refused() -> None:
    first, _ = small_experiment("x")
    with pytest.raises(ExperimentFileError, match=r"b\.h5 is of rig 'other'.*give experiments of one rig"):
        merged([first, replace(first, rig="other")], ["a.h5", "b.h5"])
