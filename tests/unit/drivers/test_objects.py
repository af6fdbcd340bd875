"""One description, three renderings: the page, the EDS and the maps say the same."""

import io
from pathlib import Path

import pytest
from canopen import ObjectDictionary
from canopen.objectdictionary import import_od

from drivers.canopen.dictionary import eds, object_dictionary
from drivers.canopen.map import DEFAULT_MAP
from drivers.objects import BY_NAME, GROUPS, Type
from drivers.reference import page

DOCS = Path(__file__).parents[3] / "docs"


def _imported() -> ObjectDictionary:
    file = io.StringIO(eds(5))
    file.name = "amb.eds"
    return import_od(file, 5)


def test_page_is_the_one_that_is_generated() -> None:
    assert (DOCS / "objects.md").read_text(encoding="utf-8") == page(), (
        "make it anew: python -m drivers.reference docs/objects.md"
    )


def test_eds_is_the_one_that_is_generated() -> None:
    assert (DOCS / "amb.eds").read_text(encoding="utf-8") == eds(), (
        "make it anew: python -m drivers.canopen docs/amb.eds"
    )


@pytest.mark.parametrize("group", GROUPS, ids=lambda g: g.name)
def test_eds_keeps_names_types_limits_factors_and_units(group) -> None:
    record = _imported()[0x2000 + group.index]
    own = object_dictionary(5)[0x2000 + group.index]
    for sub in DEFAULT_MAP.of(group.name):
        variable = record[sub.subindex]
        assert variable.name == sub.name
        assert variable.data_type == own[sub.subindex].data_type
        assert variable.access_type == group.access
        assert (variable.min, variable.max) == (own[sub.subindex].min, own[sub.subindex].max)
        assert variable.factor == pytest.approx(1 / sub.obj.per_unit)
        assert variable.unit == sub.obj.unit


def test_process_data_fit_their_frames() -> None:
    od = _imported()
    for index, size in ((0x1600, 64), (0x1601, 32), (0x1A00, 64)):
        mapped = [od[index][k].default for k in range(1, len(od[index]))]
        assert sum(entry & 0xFF for entry in mapped) == size
        for entry in mapped:
            assert od[entry >> 16][entry >> 8 & 0xFF].name in ("token", "count", "state", "command", "outcome")


def test_names_are_unique_and_texts_have_whole_registers() -> None:
    for group in GROUPS:
        names = [o.name for o in group.objects]
        assert len(set(names)) == len(names)
        assert all(o.count % 2 == 0 for o in group.objects if o.type is Type.TEXT)
        assert BY_NAME[group.name] is group
    assert len({g.index for g in GROUPS}) == len(GROUPS)


def test_every_command_but_stop_is_guarded_by_a_crc() -> None:
    for group in GROUPS:
        assert (group.objects[-1].name == "crc") == (group.name != "stop")
