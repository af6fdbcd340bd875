"""The datasheet lies beside the results that it belongs to, in its author's words where it says the same."""

from pathlib import Path

import pytest

from service.bootstrap import DATASHEET, write_datasheet
from sim.reference import reference_datasheet
from sim.rig_file import read, to_toml

SHEET = reference_datasheet()


def test_a_file_that_says_the_same_is_left_as_it_was_written(tmp_path: Path) -> None:
    written = "# measured on the bench\n" + to_toml(SHEET)
    (tmp_path / DATASHEET).write_text(written)
    assert write_datasheet(tmp_path, SHEET).read_text() == written


@pytest.mark.parametrize("before", ["", "no datasheet = [", "[effects.gremlins]\nsize = 1.0\n"])
def test_another_one_is_replaced(tmp_path: Path, before: str) -> None:
    (tmp_path / DATASHEET).write_text(before)
    assert read(write_datasheet(tmp_path, SHEET)) == SHEET
