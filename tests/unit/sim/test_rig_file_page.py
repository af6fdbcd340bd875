"""docs/rig-file.md names every field that a datasheet may have, and the tolerances that are assumed."""

import re
from dataclasses import fields
from pathlib import Path

import pytest
from pydantic import BaseModel

from sim import rig_file
from sim.datasheet import Tolerance

PAGE = (Path(__file__).parents[3] / "docs" / "rig-file.md").read_text()


def section(name: str) -> type[BaseModel]:
    """The model of one section."""
    return getattr(rig_file, {"modes": "_Mode"}.get(name, f"_{name.capitalize()}"))


@pytest.mark.parametrize("name", sorted(set(rig_file._File.model_fields) - {"effects", "tolerance"}))
def test_every_field_is_there(name: str) -> None:
    (row,) = re.findall(rf"^\| `\[+{name}\]+`.*$", PAGE, re.MULTILINE)
    assert set(section(name).model_fields) <= set(re.findall(r"`(\w+)`", row)) | set(re.findall(r"`(\w+)`:", row))


def test_the_assumed_tolerances_are_these() -> None:
    table = PAGE.split("| tolerance | assumed |")[1]
    told = {
        name: float(value)
        for names, value in re.findall(r"^\| (`.*`) \| ([\d.]+) \|$", table, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", names)
    }
    assert told == {f.name: f.default for f in fields(Tolerance)}


def test_the_largest_and_smallest_figures_are_these() -> None:
    (largest,) = re.findall(r"whatever is beyond (\S+) or", PAGE)
    (smallest,) = re.findall(r"below (\S+)\.\n", PAGE)
    assert (float(largest), float(smallest)) == (rig_file.FARTHEST, 1 / rig_file.FARTHEST)
