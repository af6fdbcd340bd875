"""Objects to registers and back, and the frames of bulk reading. Pure."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from drivers.errors import BusError
from drivers.modbus.map import Entry
from drivers.objects import Type
from drivers.packing import Order, Value, decode, encode

READ_INPUT = 4
_REQUEST = struct.Struct(">HHHBBHH")
_ANSWER = struct.Struct(">HHHBBB")


def _swapped(raw: bytes, width: int) -> bytes:
    """Registers of every value in the opposite order."""
    return b"".join(raw[at + k : at + k + 2] for at in range(0, len(raw), width) for k in range(width - 2, -2, -2))


def _width(entry: Entry) -> int:
    return 2 if entry.obj.type is Type.TEXT else entry.obj.size // entry.obj.count


def entry_bytes(entry: Entry, value: Value, word_order: Order) -> bytes:
    """One object as its registers' bytes."""
    raw = encode(entry.obj, value)
    return _swapped(raw, _width(entry)) if word_order == "little" else raw


def entry_value(entry: Entry, raw: bytes, word_order: Order) -> Value:
    """Value of one object from its registers' bytes."""
    return decode(entry.obj, _swapped(raw, _width(entry)) if word_order == "little" else raw)


def to_registers(raw: bytes) -> list[int]:
    """Registers of bytes, big-endian."""
    return list(struct.unpack(f">{len(raw) // 2}H", raw))


def to_bytes(registers: Sequence[int]) -> bytes:
    """Bytes of registers, big-endian."""
    return struct.pack(f">{len(registers)}H", *registers)


def read_request(transaction: int, unit: int, address: int, count: int) -> bytes:
    """Modbus TCP frame that reads input registers."""
    return _REQUEST.pack(transaction, 0, 6, unit, READ_INPUT, address, count)


def read_response(frame: bytes, transaction: int, unit: int, count: int) -> bytes:
    """Register bytes of the answer to `read_request`.

    Raises
    ------
    BusError
        The answer belongs to another request, or is an exception, or cut short.
    """
    if len(frame) != 9 + 2 * count:
        raise BusError(f"the answer has {len(frame)} bytes instead of {9 + 2 * count}")
    if _ANSWER.unpack_from(frame) != (transaction, 0, 3 + 2 * count, unit, READ_INPUT, 2 * count):
        raise BusError("the answer belongs to another request")
    return frame[9:]
