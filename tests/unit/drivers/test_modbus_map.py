"""A rig's own register map: what it may say, and what it hears when it is wrong."""

import re
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.errors import MapError
from drivers.modbus.map import DEFAULT_MAP, MAX_READ, MAX_WRITE, parse_map, read_map
from drivers.objects import GROUPS


def test_default_map_has_every_object_once_and_apart() -> None:
    assert len(DEFAULT_MAP.entries) == sum(len(g.objects) for g in GROUPS)
    ordered = sorted(DEFAULT_MAP.entries, key=lambda e: e.address)
    assert all(one.end <= two.address for one, two in pairwise(ordered))


@pytest.mark.parametrize("group", [g.name for g in GROUPS])
def test_every_group_of_the_default_map_is_one_frame(group: str) -> None:
    assert len(DEFAULT_MAP.spans(group, MAX_WRITE)) == 1
    assert len(DEFAULT_MAP.spans(group, MAX_READ)) == 1


def test_empty_file_is_the_default_map() -> None:
    assert parse_map("") == DEFAULT_MAP


def test_overrides_move_retype_and_rescale() -> None:
    text = """
word_order = "little"
[objects."status.crc"]
absent = true
[objects."status.excitation_a"]
address = 9000
type = "U16"
per_unit = 1000
[objects."status.lease_holder"]
absent = true
"""
    registers = parse_map(text)
    moved = next(e for e in registers.of("status") if e.obj.name == "excitation_a")
    assert (moved.address, moved.size, moved.obj.per_unit) == (9000, 1, 1000)
    assert "lease_holder" not in [e.obj.name for e in registers.of("status")]
    assert registers.word_order == "little"
    assert len(registers.spans("status", MAX_READ)) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("word_order = 3", "word_order"),
        ("colour = 1", "colour"),
        ("[objects", "not valid TOML"),
        ('[objects."status.warmth"]\naddress = 1', "no object 'status.warmth'"),
        ('[objects."status.state"]\nabsent = true', "status.state cannot be absent"),
        ('[objects."status.state"]\naddress = 70000', "less than or equal to 65535"),
        ('[objects."status.state"]\naddress = "1"', "valid integer"),
        ('[objects."stop.token"]\naddress = 65535', "does not fit behind address 65535"),
        ('[objects."status.state"]\ntype = "F16"', "cannot have the type 'F16'"),
        ('[objects."status.state"]\ntype = "U32"', "status.crc must be absent, for status.state"),
        ('[objects."status.lease_holder"]\nabsent = true', "status.crc must be absent, for status.lease_holder"),
        ('[objects."status.state"]\naddress = 0', "overlaps"),
        ('[objects."status.excitation_a"]\nper_unit = 0', "greater than 0"),
    ],
)
def test_wrong_map_is_refused_in_one_line_that_names_it(text: str, message: str) -> None:
    with pytest.raises(MapError, match=re.escape(message)) as refused:
        parse_map(text, "rig-map.toml")
    assert "rig-map.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"nowhere\.toml"):
        read_map(tmp_path / "nowhere.toml")
