"""Where each object lives in the registers: the default map from `drivers.objects`, and a rig's own from TOML.

A rig's own map overrides addresses, types and scales, and says which objects it does not have::

    word_order = "little"            # of values of more than one register; "big" unless said
    lockin_address = 2000            # data area, input registers
    [objects."status.excitation_a"]
    address = 310
    type = "U16"
    per_unit = 1000                  # counts per ampere
    [objects."status.lease_holder"]
    absent = true
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from drivers.errors import MapError
from drivers.objects import GROUPS, Group, Object
from drivers.own_map import Override, check_pieces, own_objects, parsed, read_text
from drivers.packing import Order

GROUP_STRIDE = 0x100
LOCKIN_ADDRESS = 0
RAW_ADDRESS = 0x4000
MAX_READ = 125
MAX_WRITE = 123


@dataclass(frozen=True)
class Entry:
    """One object's place. ``registers`` is [address, address + size)."""

    address: int
    group: str
    obj: Object

    @property
    def size(self) -> int:
        """Number of registers."""
        return self.obj.size // 2

    @property
    def end(self) -> int:
        """First address after it."""
        return self.address + self.size


@dataclass(frozen=True)
class RegisterMap:
    """All objects of a controller in its holding registers, and its data areas in the input registers."""

    entries: tuple[Entry, ...]
    word_order: Order = "big"
    lockin_address: int = LOCKIN_ADDRESS
    raw_address: int = RAW_ADDRESS

    def of(self, group: str) -> tuple[Entry, ...]:
        """Entries of one group, in the order of its objects."""
        return tuple(e for e in self.entries if e.group == group)

    def spans(self, group: str, limit: int) -> list[tuple[Entry, ...]]:
        """Entries of a group in runs without a gap, each of at most ``limit`` registers."""
        runs: list[list[Entry]] = []
        for entry in self.of(group):
            if runs and runs[-1][-1].end == entry.address and entry.end - runs[-1][0].address <= limit:
                runs[-1].append(entry)
            else:
                runs.append([entry])
        return [tuple(run) for run in runs]


def _default_entries(groups: tuple[Group, ...]) -> tuple[Entry, ...]:
    entries: list[Entry] = []
    for group in groups:
        address = group.index * GROUP_STRIDE
        for obj in group.objects:
            entries.append(Entry(address, group.name, obj))
            address += obj.size // 2
    return tuple(entries)


DEFAULT_MAP = RegisterMap(_default_entries(GROUPS))


class _Override(Override):
    address: Annotated[int, Field(ge=0, le=0xFFFF, strict=True)] | None = None


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    word_order: Order = "big"
    lockin_address: Annotated[int, Field(ge=0, le=0xFFFF, strict=True)] = LOCKIN_ADDRESS
    raw_address: Annotated[int, Field(ge=0, le=0xFFFF, strict=True)] = RAW_ADDRESS
    objects: dict[str, _Override] = {}


def read_map(path: Path) -> RegisterMap:
    """A rig's own map from a TOML file; errors name the file."""
    return parse_map(read_text(path), str(path))


def parse_map(text: str, source: str = "map.toml") -> RegisterMap:
    """A rig's own map from TOML text.

    Raises
    ------
    MapError
        One line that names the file, the object and what is wrong with it.
    """
    file = parsed(text, source, _File)
    places = {f"{e.group}.{e.obj.name}": e for e in DEFAULT_MAP.entries}
    entries = []
    objects = own_objects(file.objects, source)
    for name, obj in objects.items():
        own = file.objects[name].address if name in file.objects else None
        entry = replace(places[name], obj=obj, address=places[name].address if own is None else own)
        if entry.end > 0x10000:
            raise MapError(f"{source}: {name} does not fit behind address {entry.address}")
        entries.append(entry)
    _check_overlaps(entries, source)
    registers = RegisterMap(tuple(entries), file.word_order, file.lockin_address, file.raw_address)
    check_pieces(objects, lambda group: len(registers.spans(group, MAX_READ)) == 1, source)
    return registers


def _check_overlaps(entries: list[Entry], source: str) -> None:
    ordered = sorted(entries, key=lambda e: e.address)
    for one, two in pairwise(ordered):
        if two.address < one.end:
            raise MapError(
                f"{source}: {two.group}.{two.obj.name} at {two.address} overlaps {one.group}.{one.obj.name}, "
                f"which ends at {one.end - 1}"
            )
