"""Where each object lives in the CANopen object dictionary: the default map, and a rig's own from TOML.

=============  ===========================================================================================
0x2000 + k     record of group k: sub-index 1 and on, one object each, for any CANopen tool
0x2100 + k     the same group whole, a DOMAIN, little-endian: one atomic transfer
0x2200         lock-in payload of the last result, DOMAIN
0x2201         raw record of the last result, DOMAIN
0x2202         the segment of it that was chosen with the group window, DOMAIN
RPDO 1         heartbeat: token, count          COB-ID 0x200 + node
RPDO 2         stop: token                      COB-ID 0x300 + node
TPDO 1         state, command, outcome          COB-ID 0x180 + node, when a tone begins and ends
EMCY           on a trip                        COB-ID 0x080 + node
=============  ===========================================================================================

Stop and heartbeat are never SDOs: the upload of a raw record holds the SDO channel for seconds.

A rig's own map overrides places, types and scales, and says which objects it does not have. A group with an override,
and every group of a rig without the DOMAINs, is read and written object by object::

    whole_groups = false             # it has no DOMAINs of groups
    lockin_index = 0x5200
    beat_cob_id = 0x400              # plus the node's number
    [objects."status.excitation_a"]
    index = 0x3010
    subindex = 2
    type = "U16"
    per_unit = 1000                  # counts per ampere
    [objects."status.lease_holder"]
    absent = true
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from drivers.canopen.codec import BEAT_COB, PROGRESS_COB, STOP_COB
from drivers.errors import MapError
from drivers.objects import BY_NAME, GROUPS, Group, Object, Type
from drivers.own_map import Override, check_pieces, own_objects, parsed, read_text

RECORD_INDEX = 0x2000
WHOLE_INDEX = 0x2100
LOCKIN_INDEX = 0x2200
RAW_INDEX = 0x2201
SEGMENT_INDEX = 0x2202
SEGMENT_BYTES = 4 * 127 * 7
"""Of a raw record: four blocks of an SDO upload, which come through a bus on which the whole never does."""
FIRST_INDEX, LAST_INDEX, LAST_SUBINDEX = 0x2000, 0x9FFF, 0xFE
PROGRESS_OBJECTS = ("state", "command", "outcome")
"""Of the group status, in the order of TPDO 1."""


@dataclass(frozen=True)
class SubObject:
    """One sub-index: an object, or one value of an object that holds several."""

    index: int
    subindex: int
    group: Group
    obj: Object
    element: int | None
    """Which value of the object; None for a text or a single value."""

    @property
    def name(self) -> str:
        """Name in the EDS."""
        return self.obj.name if self.element is None else f"{self.obj.name}_{self.element}"

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return self.obj.size if self.element is None else self.obj.size // self.obj.count


@dataclass(frozen=True)
class ObjectMap:
    """All objects of a controller in its object dictionary, and the identifiers of its process data."""

    subs: tuple[SubObject, ...]
    whole: frozenset[str] = frozenset(BY_NAME)
    """Groups that are carried whole, by a DOMAIN each."""
    lockin_index: int = LOCKIN_INDEX
    raw_index: int = RAW_INDEX
    segment_index: int = SEGMENT_INDEX
    beat_cob_id: int = BEAT_COB
    stop_cob_id: int = STOP_COB
    progress_cob_id: int = PROGRESS_COB
    """COB-IDs, to which the node's number is added."""

    def of(self, group: str) -> tuple[SubObject, ...]:
        """Sub-indices of one group, in the order of its objects."""
        return tuple(s for s in self.subs if s.group.name == group)

    def pieces(self, group: str) -> list[tuple[Object, list[SubObject]]]:
        """Objects of one group, in order, each with its sub-indices."""
        found: dict[str, tuple[Object, list[SubObject]]] = {}
        for sub in self.of(group):
            found.setdefault(sub.obj.name, (sub.obj, []))[1].append(sub)
        return list(found.values())


def _sub_objects(group: Group, obj: Object, index: int, subindex: int) -> list[SubObject]:
    if obj.type is Type.TEXT or obj.count == 1:
        return [SubObject(index, subindex, group, obj, None)]
    return [SubObject(index, subindex + k, group, obj, k) for k in range(obj.count)]


def _default_subs(groups: Iterable[Group]) -> tuple[SubObject, ...]:
    subs: list[SubObject] = []
    for group in groups:
        subindex = 1
        for obj in group.objects:
            subs += _sub_objects(group, obj, RECORD_INDEX + group.index, subindex)
            subindex = subs[-1].subindex + 1
    return tuple(subs)


DEFAULT_MAP = ObjectMap(_default_subs(GROUPS))

_Index = Annotated[int, Field(ge=FIRST_INDEX, le=LAST_INDEX, strict=True)]
_CobId = Annotated[int, Field(ge=0x180, le=0x500, strict=True)]


class _Override(Override):
    index: _Index | None = None
    subindex: Annotated[int, Field(ge=0, le=LAST_SUBINDEX, strict=True)] | None = None


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    whole_groups: bool = True
    lockin_index: _Index = LOCKIN_INDEX
    raw_index: _Index = RAW_INDEX
    segment_index: _Index = SEGMENT_INDEX
    beat_cob_id: _CobId = BEAT_COB
    stop_cob_id: _CobId = STOP_COB
    progress_cob_id: _CobId = PROGRESS_COB
    objects: dict[str, _Override] = {}


def read_map(path: Path) -> ObjectMap:
    """A rig's own map from a TOML file; errors name the file."""
    return parse_map(read_text(path), str(path))


def parse_map(text: str, source: str = "map.toml") -> ObjectMap:
    """A rig's own map from TOML text.

    Raises
    ------
    MapError
        One line that names the file, the object and what is wrong with it.
    """
    file = parsed(text, source, _File)
    _check_process_data(file, source)
    places = {f"{s.group.name}.{s.obj.name}": s for s in reversed(DEFAULT_MAP.subs)}
    subs: list[SubObject] = []
    objects = own_objects(file.objects, source)
    for name, obj in objects.items():
        default, own = places[name], file.objects.get(name, _Override())
        index = default.index if own.index is None else own.index
        subindex = default.subindex if own.subindex is None else own.subindex
        placed = _sub_objects(default.group, obj, index, subindex)
        if placed[-1].subindex > LAST_SUBINDEX:
            raise MapError(f"{source}: {name} does not fit behind sub-index {subindex}")
        subs += placed
    overridden = {name.split(".")[0] for name in file.objects}
    whole = frozenset(g.name for g in GROUPS if file.whole_groups and g.name not in overridden)
    found = ObjectMap(
        tuple(subs),
        whole,
        file.lockin_index,
        file.raw_index,
        file.segment_index,
        file.beat_cob_id,
        file.stop_cob_id,
        file.progress_cob_id,
    )
    _check_places(found, source)
    check_pieces(objects, lambda group: group in found.whole, source)
    return found


def _check_process_data(file: _File, source: str) -> None:
    """What travels as process data has the layout of `drivers.canopen.codec`."""
    identifiers = (file.beat_cob_id, file.stop_cob_id, file.progress_cob_id)
    if any(abs(one - two) < 0x80 for k, one in enumerate(identifiers) for two in identifiers[:k]):
        raise MapError(f"{source}: beat_cob_id, stop_cob_id and progress_cob_id must be at least 0x80 apart")
    fixed = {f"status.{name}" for name in PROGRESS_OBJECTS}
    for name, override in file.objects.items():
        if (name.startswith(("beat.", "stop.")) or name in fixed) and (override.retyped or override.absent):
            raise MapError(f"{source}: {name} is process data, too: it cannot be absent or of another type or scale")


def _check_places(objects: ObjectMap, source: str) -> None:
    """No two objects in one place; sub-index 0 belongs to a record, unless its object stands alone."""
    taken = {(WHOLE_INDEX + BY_NAME[g].index, 0): f"{g} whole" for g in objects.whole}
    for index, what in (
        (objects.lockin_index, "the lock-in payload"),
        (objects.raw_index, "the raw record"),
        (objects.segment_index, "a segment of the raw record"),
    ):
        if (index, 0) in taken:
            raise MapError(f"{source}: {what} at 0x{index:04X} overlaps {taken[index, 0]}")
        taken[index, 0] = what
    alone = {index: what for (index, _), what in taken.items()}
    records: dict[int, str] = {}
    for sub in objects.subs:
        name, place = f"{sub.group.name}.{sub.name}", f"0x{sub.index:04X} sub-index {sub.subindex}"
        other = taken.get((sub.index, sub.subindex)) or alone.get(sub.index)
        if other is None and sub.subindex == 0:
            other = records.get(sub.index)
        if other is not None:
            raise MapError(f"{source}: {name} at {place} overlaps {other}")
        taken[sub.index, sub.subindex] = name
        (alone if sub.subindex == 0 else records)[sub.index] = name
