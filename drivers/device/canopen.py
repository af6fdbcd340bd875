"""The device as a CANopen node: its object dictionary, block upload, process data, emergencies."""

from __future__ import annotations

import binascii
import struct
import threading
from contextlib import suppress
from typing import Any

import canopen
from canopen.sdo.constants import (
    BLOCK_SIZE_SPECIFIED,
    BLOCK_TRANSFER_RESPONSE,
    CRC_SUPPORTED,
    END_BLOCK_TRANSFER,
    INITIATE_BLOCK_TRANSFER,
    NO_MORE_BLOCKS,
    RESPONSE_BLOCK_UPLOAD,
    START_BLOCK_UPLOAD,
)
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from drivers.canopen.bus import open_network
from drivers.canopen.codec import (
    BEAT_COB,
    EMCY_COB,
    PROGRESS_COB,
    STOP_COB,
    Progress,
    beat_of,
    emergency_bytes,
    progress_bytes,
    stop_of,
)
from drivers.canopen.map import (
    LOCKIN_INDEX,
    RAW_INDEX,
    RECORD_INDEX,
    WHOLE_INDEX,
    SubObject,
    object_dictionary,
    sub_objects,
)
from drivers.controller import TripCause
from drivers.device.front import DeviceFront
from drivers.errors import BusError
from drivers.link import RefusedError
from drivers.objects import GROUPS, Refusal
from drivers.packing import Value, decode, encode, unpack, with_crc

ABORT_NO_DATA = 0x08000024
_NMT_STOP = (0x02, 0x80, 0x81, 0x82)
"""Stop, enter pre-operational, reset node, reset communication: none of them leaves the excitation on."""


class BlockSdoServer(SdoServer):
    """SDO server that also serves block upload, with CRC; the library's own falls back to segments."""

    def __init__(self, rx_cobid: int, tx_cobid: int, node: Any) -> None:
        super().__init__(rx_cobid, tx_cobid, node)  # type: ignore[no-untyped-call]
        self._index = self._subindex = 0
        self._data = b""
        self._position = 0
        self._block_size = 127

    def block_upload(self, data: bytes) -> None:
        """One request of a block upload (CiA 301, 7.2.4.3.13 and on)."""
        step = data[0] & 0x03
        if step == INITIATE_BLOCK_TRANSFER:
            _, self._index, self._subindex, size = struct.unpack_from("<BHBB", data)
            self._data = self._node.get_data(self._index, self._subindex, check_readable=True)
            if not self._data:
                raise SdoAbortedError(ABORT_NO_DATA)
            self._position, self._block_size = 0, max(1, min(size, 127))
            command = RESPONSE_BLOCK_UPLOAD | CRC_SUPPORTED | BLOCK_SIZE_SPECIFIED
            self.send_response(struct.pack("<BHBL", command, self._index, self._subindex, len(self._data)))  # type: ignore[no-untyped-call]
        elif step == START_BLOCK_UPLOAD:
            self._send_block()
        elif step == BLOCK_TRANSFER_RESPONSE:
            self._position += 7 * data[1]
            self._block_size = max(1, min(data[2], 127))
            if self._position >= len(self._data):
                self._send_end()
            else:
                self._send_block()

    def _send_block(self) -> None:
        for number in range(1, self._block_size + 1):
            at = self._position + 7 * (number - 1)
            last = at + 7 >= len(self._data)
            segment = bytes(self._data[at : at + 7]).ljust(7, b"\0")
            self.send_response(bytes([number | (NO_MORE_BLOCKS if last else 0)]) + segment)  # type: ignore[no-untyped-call]
            if last:
                return

    def _send_end(self) -> None:
        unused = -len(self._data) % 7
        command = RESPONSE_BLOCK_UPLOAD | END_BLOCK_TRANSFER | (unused << 2)
        self.send_response(struct.pack("<BHxxxxx", command, binascii.crc_hqx(bytes(self._data), 0)))  # type: ignore[no-untyped-call]


class CanopenNode:
    """The device on a CAN bus until `close`.

    Parameters
    ----------
    front
        The device; byte order little.
    address
        As in `drivers.canopen.bus`.

    Raises
    ------
    BusError
        The bus cannot be opened.
    """

    def __init__(self, front: DeviceFront, address: str, node_id: int, bitrate: int = 1_000_000) -> None:
        self._front = front
        self._subs = {(s.index, s.subindex): s for group in GROUPS for s in sub_objects(group)}
        self._staged: dict[str, dict[str, Any]] = {}
        self._trip = TripCause.NONE
        self._node_id = node_id
        self._network = open_network(address, bitrate)
        self._node = canopen.LocalNode(node_id, object_dictionary(node_id))
        self._node.sdo = BlockSdoServer(0x600 + node_id, 0x580 + node_id, self._node)
        self._node.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        self._node.add_write_callback(self._write)  # type: ignore[no-untyped-call]
        self._network.add_node(self._node)
        self._network.subscribe(BEAT_COB + node_id, self._on_beat)
        self._network.subscribe(STOP_COB + node_id, self._on_stop)
        self._network.subscribe(0, self._on_nmt)
        self._closing = threading.Event()
        front.on_change(self._tell)
        with suppress(Exception):
            self._node.nmt.send_command(0)  # boot-up message

    def close(self) -> None:
        """Leave the bus; safe twice."""
        if not self._closing.is_set():
            self._closing.set()
            self._network.disconnect()

    # ---- SDO

    def _read(self, index: int, subindex: int, od: object) -> bytes | None:
        try:
            if index == LOCKIN_INDEX:
                return self._front.lockin_payload()
            if index == RAW_INDEX:
                return self._front.raw_record()
            if (index, subindex) in self._subs:
                return self._read_one(self._subs[index, subindex])
            if WHOLE_INDEX <= index < WHOLE_INDEX + len(GROUPS):
                group = GROUPS[index - WHOLE_INDEX]
                values = self._front.read(group.name)
                return b"".join(encode(o, values[o.name], "little") for o in group.objects)
        except RefusedError as refused:
            raise SdoAbortedError(refused.refusal.canopen) from refused
        return None

    def _read_one(self, sub: SubObject) -> bytes:
        raw = encode(sub.obj, self._front.read(sub.group.name)[sub.obj.name], "little")
        if sub.element is None:
            return raw
        size = sub.obj.size // sub.obj.count
        return raw[sub.element * size : (sub.element + 1) * size]

    def _write(self, index: int, subindex: int, od: object, data: bytes) -> None:
        try:
            if WHOLE_INDEX <= index < WHOLE_INDEX + len(GROUPS):
                group = GROUPS[index - WHOLE_INDEX]
                self._front.write(group.name, unpack(group, bytes(data), "little"))
            elif RECORD_INDEX <= index < RECORD_INDEX + len(GROUPS):
                self._write_one(self._subs[index, subindex], bytes(data))
        except RefusedError as refused:
            raise SdoAbortedError(refused.refusal.canopen) from refused
        except BusError as error:
            raise SdoAbortedError(Refusal.LIMIT.canopen) from error

    def _write_one(self, sub: SubObject, data: bytes) -> None:
        """Objects one by one; the group acts when its last one is written."""
        staged = self._staged.setdefault(sub.group.name, {})
        staged[sub.obj.name] = decode(sub.obj, data.ljust(sub.obj.size, b"\0"), "little")
        if sub.obj is sub.group.objects[-1]:
            del self._staged[sub.group.name]
            if len(staged) != len(sub.group.objects):
                raise RefusedError(Refusal.LIMIT, f"{sub.group.name} is incomplete")
            self._front.write(sub.group.name, staged)

    # ---- process data

    def _on_beat(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        with suppress(BusError, RefusedError):
            token, count = beat_of(bytes(data))
            self._write_group("beat", {"token": token, "count": count})

    def _on_stop(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        self._front.device.stop(stop_of(bytes(data)))

    def _on_nmt(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        if len(data) >= 2 and data[0] in _NMT_STOP and data[1] in (0, self._node_id):
            self._front.device.stop()

    def _write_group(self, group: str, values: dict[str, Value]) -> None:
        of = next(g for g in GROUPS if g.name == group)
        self._front.write(group, with_crc(of, values))

    def _tell(self) -> None:
        """Progress, and an emergency when a trip is new; from the tone's thread."""
        if self._closing.is_set():
            return
        status = self._front.read("status")
        progress = Progress(int(status["state"]), int(status["command"]), int(status["outcome"]))  # type: ignore[arg-type]
        trip = TripCause(int(status["trip"]))  # type: ignore[arg-type]
        with suppress(Exception):  # a bus that is off: the host reads the status when it is back
            if trip is not self._trip:
                self._network.send_message(EMCY_COB + self._node_id, emergency_bytes(trip))
                self._trip = trip
            self._network.send_message(PROGRESS_COB + self._node_id, progress_bytes(progress))
