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

import tomllib
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import MapError
from drivers.objects import GROUPS, Group, Object, Type
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


class _Override(BaseModel):
    model_config = ConfigDict(extra="forbid")
    address: Annotated[int, Field(ge=0, le=0xFFFF, strict=True)] | None = None
    type: str | None = None
    per_unit: Annotated[int, Field(gt=0, strict=True)] | None = None
    absent: bool = False


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    word_order: Order = "big"
    lockin_address: Annotated[int, Field(ge=0, le=0xFFFF, strict=True)] = LOCKIN_ADDRESS
    raw_address: Annotated[int, Field(ge=0, le=0xFFFF, strict=True)] = RAW_ADDRESS
    objects: dict[str, _Override] = {}


def read_map(path: Path) -> RegisterMap:
    """A rig's own map from a TOML file; errors name the file."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MapError(f"cannot read the map {path}: {error}") from error
    return parse_map(text, str(path))


def parse_map(text: str, source: str = "map.toml") -> RegisterMap:
    """A rig's own map from TOML text.

    Raises
    ------
    MapError
        One line that names the file, the object and what is wrong with it.
    """
    try:
        file = _File.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise MapError(f"{source} is not valid TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise MapError(f"{source}: {'.'.join(str(p) for p in first['loc'])}: {first['msg']}") from error
    known = {f"{e.group}.{e.obj.name}" for e in DEFAULT_MAP.entries}
    if unknown := sorted(set(file.objects) - known):
        raise MapError(f"{source}: there is no object {unknown[0]!r}; the reference page lists them")
    changed = _changed_groups(file)
    entries = []
    for entry in DEFAULT_MAP.entries:
        name = f"{entry.group}.{entry.obj.name}"
        override = file.objects.get(name, _Override())
        if override.absent:
            if entry.obj.required:
                raise MapError(f"{source}: {name} cannot be absent: the driver needs it")
            continue
        if entry.obj.name == "crc" and entry.group in changed:
            raise MapError(
                f"{source}: {name} must be absent, for {changed[entry.group]} is not as the CRC takes it to be"
            )
        entries.append(_placed(entry, override, source))
    _check_overlaps(entries, source)
    return RegisterMap(tuple(entries), file.word_order, file.lockin_address, file.raw_address)


def _changed_groups(file: _File) -> dict[str, str]:
    """Groups whose content differs from the default, and one object that does."""
    return {
        name.split(".")[0]: name
        for name, o in file.objects.items()
        if (o.absent and not name.endswith(".crc")) or o.type is not None or o.per_unit is not None
    }


def _placed(entry: Entry, override: _Override, source: str) -> Entry:
    obj = entry.obj
    if override.type is not None:
        if override.type not in Type.__members__ or (Type[override.type] is Type.TEXT) != (obj.type is Type.TEXT):
            raise MapError(f"{source}: {entry.group}.{obj.name} cannot have the type {override.type!r}")
        obj = replace(obj, type=Type[override.type])
    if override.per_unit is not None:
        obj = replace(obj, per_unit=override.per_unit)
    address = entry.address if override.address is None else override.address
    if address + obj.size // 2 > 0x10000:
        raise MapError(f"{source}: {entry.group}.{obj.name} does not fit behind address {address}")
    return replace(entry, address=address, obj=obj)


def _check_overlaps(entries: list[Entry], source: str) -> None:
    ordered = sorted(entries, key=lambda e: e.address)
    for one, two in pairwise(ordered):
        if two.address < one.end:
            raise MapError(
                f"{source}: {two.group}.{two.obj.name} at {two.address} overlaps {one.group}.{one.obj.name}, "
                f"which ends at {one.end - 1}"
            )
