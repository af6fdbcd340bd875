"""The device's registers: Modbus requests answered from a `DeviceFront`, whatever the transport.

Holding registers (functions 3, 6, 16) hold the objects of the map, input registers (function 4) the data of the
last result. A group acts when its last object is written; one request sees one snapshot of a group.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from drivers.device.front import DeviceFront
from drivers.errors import ControllerError
from drivers.link import RefusedError
from drivers.modbus.codec import entry_bytes, entry_value
from drivers.modbus.map import MAX_READ, MAX_WRITE, Entry, RegisterMap
from drivers.objects import BY_NAME, Refusal
from drivers.packing import Value
from drivers.pages import SEGMENT_BYTES

ILLEGAL_FUNCTION = 1
DEVICE_FAILURE = 4


_PAIR = struct.Struct(">HH")


class RegisterSession:
    """Requests of one connection. Objects that are written one by one are gathered per connection.

    Parameters
    ----------
    front
        The device; byte order big.
    """

    def __init__(self, front: DeviceFront, registers: RegisterMap) -> None:
        self._front = front
        self._map = registers
        self._entries = sorted(registers.entries, key=lambda e: e.address)
        self._last = {g: registers.of(g)[-1].obj.name for g in BY_NAME if registers.of(g)}
        self._staged: dict[str, dict[str, Value]] = {}
        self._functions: dict[int, Callable[[bytes], bytes]] = {
            3: self._read_holding,
            4: self._read_input,
            6: self._write_one,
            16: self._write_many,
        }

    def answer(self, request: bytes) -> bytes:
        """Response PDU to a request PDU, an exception included."""
        function = request[0] if request else 0
        try:
            if function not in self._functions:
                return bytes([function | 0x80, ILLEGAL_FUNCTION])
            return bytes([function]) + self._functions[function](request[1:])
        except RefusedError as refused:
            return bytes([function | 0x80, refused.refusal.modbus])
        except struct.error:
            return bytes([function | 0x80, Refusal.LIMIT.modbus])
        except ControllerError:
            return bytes([function | 0x80, DEVICE_FAILURE])

    def _read_holding(self, body: bytes) -> bytes:
        address, count = _PAIR.unpack(body)
        if not 1 <= count <= MAX_READ:
            raise RefusedError(Refusal.LIMIT, "too many registers")
        snapshots: dict[str, dict[str, Value]] = {}
        image = bytearray(2 * count)
        covered = 0
        for e in self._touched(address, count):
            if e.group not in snapshots:
                if BY_NAME[e.group].access != "ro":
                    raise RefusedError(Refusal.ADDRESS, "write only")
                snapshots[e.group] = self._front.read(e.group)
            raw = entry_bytes(e, snapshots[e.group][e.obj.name], self._map.word_order)
            first, last = max(e.address, address), min(e.end, address + count)
            image[2 * (first - address) : 2 * (last - address)] = raw[2 * (first - e.address) : 2 * (last - e.address)]
            covered += last - first
        if covered != count:
            raise RefusedError(Refusal.ADDRESS, "no object there")
        return bytes([2 * count]) + image

    def _read_input(self, body: bytes) -> bytes:
        address, count = _PAIR.unpack(body)
        if not 1 <= count <= MAX_READ:
            raise RefusedError(Refusal.LIMIT, "too many registers")
        if address >= self._map.raw_address:
            window = self._front.window
            first = SEGMENT_BYTES * window + 2 * (address - self._map.raw_address)
            part = self._front.raw_pages()[first : min(first + 2 * count, SEGMENT_BYTES * (window + 1))]
        else:
            start = 2 * (address - self._map.lockin_address)
            part = self._front.lockin_payload()[start : start + 2 * count] if start >= 0 else b""
        if len(part) != 2 * count:
            raise RefusedError(Refusal.ADDRESS, "no data there")
        return bytes([2 * count]) + part

    def _write_one(self, body: bytes) -> bytes:
        address, _ = struct.unpack(">HH", body)
        self._write(address, body[2:])
        return body

    def _write_many(self, body: bytes) -> bytes:
        address, count, size = struct.unpack_from(">HHB", body)
        if not 1 <= count <= MAX_WRITE or size != 2 * count or len(body) != 5 + size:
            raise RefusedError(Refusal.LIMIT, "wrong length")
        self._write(address, body[5:])
        return body[:4]

    def _write(self, address: int, raw: bytes) -> None:
        count = len(raw) // 2
        entries = self._touched(address, count)
        whole = all(e.address >= address and e.end <= address + count for e in entries)
        if not whole or sum(e.size for e in entries) != count:
            raise RefusedError(Refusal.ADDRESS, "only whole objects can be written")
        if any(BY_NAME[e.group].access != "wo" for e in entries):
            raise RefusedError(Refusal.ADDRESS, "read only")
        for e in entries:
            staged = self._staged.setdefault(e.group, {})
            staged[e.obj.name] = entry_value(
                e, raw[2 * (e.address - address) : 2 * (e.end - address)], self._map.word_order
            )
            if e.obj.name == self._last[e.group]:
                del self._staged[e.group]
                if len(staged) != len(self._map.of(e.group)):
                    raise RefusedError(Refusal.LIMIT, f"{e.group} is incomplete")
                self._front.write(e.group, staged)

    def _touched(self, address: int, count: int) -> list[Entry]:
        return [e for e in self._entries if e.address < address + count and e.end > address]
