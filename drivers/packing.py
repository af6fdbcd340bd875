"""Groups of objects to bytes and back: the same for every bus but for the byte order. Pure."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from typing import Literal

from drivers.errors import BusError, LimitError
from drivers.objects import Group, Object, Type

Value = int | float | str | tuple[float, ...]
Values = Mapping[str, Value]
Order = Literal["big", "little"]
_PREFIX = {"big": ">", "little": "<"}
INTEGERS = {Type.U16: (0, 2**16 - 1), Type.U32: (0, 2**32 - 1), Type.I32: (-(2**31), 2**31 - 1)}
"""The least and the greatest count of each type that counts."""


def encode(obj: Object, value: Value, order: Order = "big") -> bytes:
    """Bytes of one object's value, given in SI.

    Raises
    ------
    LimitError
        The value is outside the object's limits, or of what its type holds.
    """
    if obj.type is Type.TEXT:
        raw = str(value).encode("utf-8")[: obj.count]
        return raw.decode("utf-8", "ignore").encode("utf-8").ljust(obj.count, b"\0")
    numbers = value if isinstance(value, tuple) else (value,)
    if len(numbers) > obj.count:
        raise LimitError(f"{obj.name} has {len(numbers)} values; it holds {obj.count}")
    counts = [_counts(obj, number) for number in numbers] + [0] * (obj.count - len(numbers))
    return struct.pack(f"{_PREFIX[order]}{obj.count}{obj.type.letter}", *counts)


def _counts(obj: Object, value: str | float) -> int | float:
    if isinstance(value, str):
        raise LimitError(f"{obj.name} is a number, not {value!r}")
    if (obj.low is not None and not value >= obj.low) or (obj.high is not None and not value <= obj.high):
        raise LimitError(f"{obj.name} = {value} {obj.unit} is outside {obj.low} to {obj.high} {obj.unit}".rstrip())
    if obj.type not in INTEGERS:
        return float(value) * obj.per_unit
    low, high = INTEGERS[obj.type]
    if obj.wraps and math.isfinite(value):
        return round(value * obj.per_unit) % (high + 1)
    if not low - 0.5 < value * obj.per_unit < high + 0.5:
        raise LimitError(f"{obj.name} = {value} {obj.unit} does not fit on the wire".replace("  ", " "))
    return round(value * obj.per_unit)


def decode(obj: Object, raw: bytes, order: Order = "big") -> Value:
    """Value in SI of one object's bytes."""
    if obj.type is Type.TEXT:
        return raw.split(b"\0", 1)[0].decode("utf-8", "replace")
    counts = struct.unpack(f"{_PREFIX[order]}{obj.count}{obj.type.letter}", raw)
    values = counts if obj.per_unit == 1 else tuple(c / obj.per_unit for c in counts)
    return values[0] if obj.count == 1 else values


def group_crc(group: Group, values: Values) -> int:
    """CRC-32 over the group's objects but the CRC itself, big-endian, in order."""
    return zlib.crc32(b"".join(encode(o, values[o.name]) for o in group.objects if o.name != "crc"))


def with_crc(group: Group, values: Values) -> dict[str, Value]:
    """Values and, if the group has one, their CRC."""
    sealed = dict(values)
    if group.objects[-1].name == "crc":
        sealed["crc"] = group_crc(group, values)
    return sealed


def check_crc(group: Group, values: Values) -> None:
    """Raise `BusError` when the group's CRC does not fit its values; a map without CRC is not checked."""
    if "crc" not in values:
        return
    try:
        fits = values["crc"] == group_crc(group, values)
    except LimitError as error:
        raise BusError(f"{group.name} holds an impossible value: {error}") from error
    if not fits:
        raise BusError(f"the CRC of {group.name} is wrong: the frame was corrupted on the bus")


def pack(group: Group, values: Values, order: Order = "big") -> bytes:
    """A whole group, CRC included."""
    sealed = with_crc(group, values)
    return b"".join(encode(o, sealed[o.name], order) for o in group.objects)


def unpack(group: Group, raw: bytes, order: Order = "big") -> dict[str, Value]:
    """Values of a whole group.

    Raises
    ------
    BusError
        Wrong length or CRC.
    """
    if len(raw) != group.size:
        raise BusError(f"{group.name} has {len(raw)} bytes instead of {group.size}: the frame was cut short")
    values: dict[str, Value] = {}
    at = 0
    for o in group.objects:
        values[o.name] = decode(o, raw[at : at + o.size], order)
        at += o.size
    check_crc(group, values)
    return values
