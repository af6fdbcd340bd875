"""What a diagnosis was made from is told by digests: the same for the same data in any file, another for other data."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from service.experiment import file
from service.experiment.data import Experiment
from service.gap.origin import datasheet_digest, experiment_digest, origin
from sim.reference import reference_datasheet
from tests.support.uploads import good, good_matlab


def test_a_file_that_is_read_and_written_again_is_the_same_experiment(tmp_path: Path) -> None:
    for name, made in (("a.h5", good), ("a.mat", good_matlab)):
        first = file.read(made(tmp_path / name))
        file.write(tmp_path / "again.h5", first)
        assert experiment_digest(file.read(tmp_path / "again.h5")) == experiment_digest(first)


def test_a_number_an_axis_or_a_sweep_more_is_another_experiment(tmp_path: Path) -> None:
    first = file.read(good(tmp_path / "a.h5"))

    def changed(**values: Any) -> Experiment:
        return replace(first, sweeps=(replace(first.main, **values),))

    louder = first.main.Y.copy()
    louder[0, 0, 0, 0] += 1e-18
    others = [
        changed(Y=louder),
        changed(I=None),
        changed(axis=np.roll(first.main.axis, 1)),
        changed(comment="validation"),
        replace(first, rig="another"),
        replace(first, sweeps=(first.main, first.main)),
    ]
    assert len({experiment_digest(e) for e in [first, *others]}) == 7


def test_a_datasheet_that_says_something_else_is_another_one() -> None:
    sheet = reference_datasheet()
    assert datasheet_digest(replace(sheet, mass_kg=np.nextafter(sheet.mass_kg, 1e9))) != datasheet_digest(sheet)


def test_the_controller_that_measured_is_told(tmp_path: Path) -> None:
    measured = replace(file.read(good(tmp_path / "a.h5")), attributes={"controller": "maker, type, name"})
    assert origin(measured, reference_datasheet())["controller"] == "maker, type, name"
