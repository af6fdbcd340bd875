"""What a rig's own map may change of the objects, whatever the bus: type, scale, absence. Read from TOML, validated."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import MapError
from drivers.objects import GROUPS, Object, Type
from drivers.packing import INTEGERS
from sim.errors import reason

M = TypeVar("M", bound=BaseModel)


class Override(BaseModel):
    """What a map says of one object; each bus adds where the object is."""

    model_config = ConfigDict(extra="forbid")
    type: str | None = None
    per_unit: Annotated[int, Field(gt=0, strict=True)] | None = None
    absent: bool = False

    @property
    def retyped(self) -> bool:
        """Whether the object means something else on the wire than by default."""
        return self.type is not None or self.per_unit is not None


def read_text(path: Path) -> str:
    """Text of a map's file; errors name it."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MapError(f"cannot read the map {path}: {reason(error)}") from error


def parsed(text: str, source: str, model: type[M]) -> M:
    """A map's TOML text as this model.

    Raises
    ------
    MapError
        Not TOML, or a value of the wrong kind; one line that names it.
    """
    try:
        return model.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise MapError(f"{source} is not valid TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise MapError(f"{source}: {'.'.join(str(p) for p in first['loc'])}: {first['msg']}") from error


def own_objects(overrides: Mapping[str, Override], source: str) -> dict[str, Object]:
    """Objects that the rig has, as it has them, by ``group.name``, in order.

    Raises
    ------
    MapError
        An object that does not exist, or that cannot be absent or of that type; or a CRC that could not be right.
    """
    known = {f"{group.name}.{obj.name}": obj for group in GROUPS for obj in group.objects}
    if unknown := sorted(set(overrides) - set(known)):
        raise MapError(f"{source}: there is no object {unknown[0]!r}; the reference page lists them")
    changed = {
        name.split(".")[0]: name
        for name, o in overrides.items()
        if (o.absent and not name.endswith(".crc")) or o.retyped
    }
    found: dict[str, Object] = {}
    for name, obj in known.items():
        override = overrides.get(name, Override())
        if override.absent:
            if obj.required:
                raise MapError(f"{source}: {name} cannot be absent: the driver needs it")
            continue
        group = name.split(".")[0]
        if obj.name == "crc" and group in changed:
            raise MapError(f"{source}: {name} must be absent, for {changed[group]} is not as the CRC takes it to be")
        found[name] = _retyped(name, obj, override, source)
    return found


def check_pieces(names: Collection[str], in_one_piece: Callable[[str], bool], source: str) -> None:
    """Refuse the CRC of a group that is read in several pieces: they come from several moments, which it cannot cover.

    Parameters
    ----------
    names
        Objects that the rig has, as ``group.name``.
    in_one_piece
        Whether a group, by its name, is read in one transfer.
    """
    for group in GROUPS:
        if group.access == "ro" and f"{group.name}.crc" in names and not in_one_piece(group.name):
            raise MapError(f"{source}: {group.name}.crc must be absent, for {group.name} is not in one piece")


def _retyped(name: str, obj: Object, override: Override, source: str) -> Object:
    if override.type is not None:
        if override.type not in Type.__members__ or (Type[override.type] is Type.TEXT) != (obj.type is Type.TEXT):
            raise MapError(f"{source}: {name} cannot have the type {override.type!r}")
        obj = replace(obj, type=Type[override.type])
        if obj.type not in INTEGERS:
            obj = replace(obj, per_unit=1)  # a float is in SI units, unless per_unit says otherwise
    return obj if override.per_unit is None else replace(obj, per_unit=override.per_unit)
