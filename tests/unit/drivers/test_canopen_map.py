"""A rig's own CANopen objects: what the map may say, what it hears when it is wrong, and the EDS that follows."""

import io
import re
from pathlib import Path

import pytest
from canopen import import_od

from drivers.canopen.dictionary import eds
from drivers.canopen.map import DEFAULT_MAP, parse_map, read_map
from drivers.errors import MapError
from drivers.objects import GROUPS, Type

OWN = """
lockin_index = 0x5200
beat_cob_id = 0x400
[objects."status.crc"]
absent = true
[objects."status.excitation_a"]
index = 0x3010
subindex = 2
type = "U16"
per_unit = 1000
[objects."status.displacement_m"]
index = 0x3010
subindex = 3
[objects."status.uptime_s"]
index = 0x3020
subindex = 0
[objects."status.lease_holder"]
absent = true
"""


def test_default_map_has_every_object_once_and_apart() -> None:
    places = [(s.index, s.subindex) for s in DEFAULT_MAP.subs]
    assert len(set(places)) == len(places)
    assert sum(len(DEFAULT_MAP.pieces(g.name)) for g in GROUPS) == sum(len(g.objects) for g in GROUPS)


def test_empty_file_is_the_default_map() -> None:
    assert parse_map("") == DEFAULT_MAP


def test_overrides_move_retype_and_rescale() -> None:
    own = parse_map(OWN)
    pieces = {obj.name: (obj, [(s.index, s.subindex) for s in subs]) for obj, subs in own.pieces("status")}
    obj, places = pieces["excitation_a"]
    assert (obj.type, obj.per_unit, places) == (Type.U16, 1000, [(0x3010, 2)])
    assert pieces["displacement_m"][1] == [(0x3010, 3), (0x3010, 4), (0x3010, 5), (0x3010, 6)]
    assert pieces["state"][1] == [(0x2001, 3)]  # the others stay where they are
    assert "lease_holder" not in pieces
    assert own.whole == DEFAULT_MAP.whole - {"status"}
    assert (own.lockin_index, own.beat_cob_id, own.stop_cob_id) == (0x5200, 0x400, 0x300)


def test_eds_of_an_own_map_tells_its_places(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(OWN)
    text = io.StringIO(eds(7, read_map(path)))
    text.name = "own.eds"
    od = import_od(text, 7)
    assert od[0x3010][2].name == "excitation_a"
    assert od[0x3010][2].factor == pytest.approx(1e-3)
    assert od[0x3020].name == "uptime_s"
    assert 0x2101 not in od  # status whole
    assert 0x2103 in od
    assert od[0x1400][1].default == 0x407


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("colour = 1", "colour"),
        ("[objects", "not valid TOML"),
        ("lockin_index = 0x1000", "greater than or equal to 8192"),
        ("lockin_index = 0x2201", "the raw record at 0x2201 overlaps the lock-in payload"),
        ("raw_index = 0x2101", "the raw record at 0x2101 overlaps status whole"),
        ("beat_cob_id = 0x580", "less than or equal to 1280"),
        ("beat_cob_id = 0x310", "at least 0x80 apart"),
        ("whole_groups = false", "identity.crc must be absent, for identity is not in one piece"),
        ('[objects."status.warmth"]\nindex = 0x3000', "no object 'status.warmth'"),
        ('[objects."status.state"]\nindex = 0x3000', "status.crc must be absent, for status is not in one piece"),
        ('[objects."status.result"]\nabsent = true', "status.result cannot be absent"),
        ('[objects."status.result"]\ntype = "U16"', "status.crc must be absent, for status.result"),
        ('[objects."status.result"]\nsubindex = "1"', "valid integer"),
        ('[objects."tone.axis"]\nindex = 0x2001\nsubindex = 1', "overlaps status.snapshot"),
        ('[objects."tone.axis"]\nindex = 0x2001\nsubindex = 0', "overlaps status."),
        ('[objects."tone.axis"]\nindex = 0x2200\nsubindex = 1', "tone.axis at 0x2200 sub-index 1 overlaps the lock-in"),
        ('[objects."status.displacement_m"]\nindex = 0x3000\nsubindex = 253', "does not fit behind sub-index 253"),
        ('[objects."status.state"]\ntype = "U32"', "status.state is process data"),
        ('[objects."beat.count"]\nper_unit = 2', "beat.count is process data"),
    ],
)
def test_wrong_map_is_refused_in_one_line_that_names_it(text: str, message: str) -> None:
    with pytest.raises(MapError, match=re.escape(message)) as refused:
        parse_map(text, "rig-map.toml")
    assert "rig-map.toml" in str(refused.value)
    assert "\n" not in str(refused.value)
