"""The device as a CANopen node: its object dictionary, block upload, process data, emergencies."""

from __future__ import annotations

import binascii
import itertools
import struct
import threading
from collections.abc import Iterator
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

from drivers.canopen.bus import open_network, send_all
from drivers.canopen.codec import (
    EMCY_COB,
    HEARTBEAT_COB,
    OPERATIONAL,
    PRE_OPERATIONAL,
    STOPPED,
    Progress,
    beat_of,
    emergency_bytes,
    progress_bytes,
    stop_of,
)
from drivers.canopen.dictionary import object_dictionary
from drivers.canopen.map import DEFAULT_MAP, SEGMENT_BYTES, WHOLE_INDEX, ObjectMap, SubObject
from drivers.controller import TripCause
from drivers.device.front import DeviceFront
from drivers.errors import BusError, ControllerError
from drivers.link import RefusedError
from drivers.objects import GROUPS, Group, Refusal
from drivers.packing import Value, decode, encode, unpack, with_crc

ABORT_NO_DATA = 0x08000024
LOOK_S = 0.1
"""How often the node looks whether its bus is still there."""
LONGEST_PAUSE_S = 2.0
HEARTBEAT_LOOKS = 5
"""After so many of these a node that waits to be started tells its state."""
_NMT_STOP = (0x02, 0x80, 0x81, 0x82)
"""Stop, enter pre-operational, reset node, reset communication: none of them leaves the excitation on."""


_NMT_STATES = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL, 0x81: PRE_OPERATIONAL, 0x82: PRE_OPERATIONAL}


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
        end = min(self._position + 7 * self._block_size, len(self._data))
        send_all(self.network, self.tx_cobid, self._segments(self._position, end))

    def _segments(self, at: int, end: int) -> Iterator[bytes]:
        for number, start in enumerate(range(at, end, 7), 1):
            last = NO_MORE_BLOCKS if start + 7 >= len(self._data) else 0
            yield bytes([number | last]) + bytes(self._data[start : start + 7]).ljust(7, b"\0")

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
    objects
        Where its objects are.
    self_starting
        Whether it takes process data from the beginning; otherwise it waits to be started (CiA 301, 7.3.2.2).

    Raises
    ------
    BusError
        The bus cannot be opened.
    """

    def __init__(
        self,
        front: DeviceFront,
        address: str,
        node_id: int,
        objects: ObjectMap = DEFAULT_MAP,
        self_starting: bool = True,
    ) -> None:
        self._front = front
        self._address, self._node_id, self._objects = address, node_id, objects
        self._self_starting = self_starting
        self._state = OPERATIONAL if self_starting else PRE_OPERATIONAL
        self._subs = {(s.index, s.subindex): s for s in objects.subs}
        self._last = {g.name: objects.of(g.name)[-1] for g in GROUPS}
        self._staged: dict[str, dict[str, Any]] = {}
        self._trip = TripCause.NONE
        self._closing = threading.Event()
        self._network = self._joined()
        front.on_change(self._tell)
        self._keeper = threading.Thread(target=self._keep_joined, name="canopen-node", daemon=True)
        self._keeper.start()

    def close(self) -> None:
        """Leave the bus; safe twice."""
        if not self._closing.is_set():
            self._closing.set()
            self._keeper.join(timeout=5.0)
            _leave(self._network)
            self._front.close()

    # ---- the bus

    def _joined(self) -> canopen.Network:
        """The bus, with this node on it."""
        network = open_network(self._address)
        node = canopen.LocalNode(self._node_id, object_dictionary(self._node_id, self._objects))
        node.sdo = BlockSdoServer(0x600 + self._node_id, 0x580 + self._node_id, node)
        node.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        node.add_write_callback(self._write)  # type: ignore[no-untyped-call]
        network.add_node(node)
        network.subscribe(self._objects.beat_cob_id + self._node_id, self._on_beat)
        network.subscribe(self._objects.stop_cob_id + self._node_id, self._on_stop)
        network.subscribe(0, self._on_nmt)
        with suppress(Exception):
            node.nmt.send_command(0)  # boot-up message
        return network

    def _keep_joined(self) -> None:
        """Join again when the bus has failed: a hub or an interface may go away and come back.

        Meanwhile no heartbeat comes, and the watchdog sees to the excitation.
        """
        for look in itertools.count():
            if self._closing.wait(LOOK_S):
                return
            if not self._self_starting and look % HEARTBEAT_LOOKS == 0:
                with suppress(Exception):
                    self._network.send_message(HEARTBEAT_COB + self._node_id, bytes([self._state]))
            notifier = self._network.notifier
            if notifier is None or notifier.exception is None:
                continue
            _leave(self._network)
            pause = LOOK_S
            while not self._closing.wait(pause):
                try:
                    self._network = self._joined()
                    break
                except ControllerError:
                    pause = min(2 * pause, LONGEST_PAUSE_S)

    # ---- SDO

    def _read(self, index: int, subindex: int, od: object) -> bytes | None:
        try:
            if index == self._objects.lockin_index:
                return self._front.lockin_payload()
            if index == self._objects.raw_index:
                return self._front.raw_record()
            if index == self._objects.segment_index:
                first = SEGMENT_BYTES * self._front.window
                return self._front.raw_record()[first : first + SEGMENT_BYTES]
            if (index, subindex) in self._subs:
                return self._read_one(self._subs[index, subindex])
            if (group := self._whole(index)) is not None:
                values = self._front.read(group.name)
                return b"".join(encode(o, values[o.name], "little") for o in group.objects)
        except RefusedError as refused:
            raise SdoAbortedError(refused.refusal.canopen) from refused
        return None

    def _whole(self, index: int) -> Group | None:
        """The group that the DOMAIN at this index carries."""
        k = index - WHOLE_INDEX
        return GROUPS[k] if 0 <= k < len(GROUPS) and GROUPS[k].name in self._objects.whole else None

    def _read_one(self, sub: SubObject) -> bytes:
        raw = encode(sub.obj, self._front.read(sub.group.name)[sub.obj.name], "little")
        return raw if sub.element is None else raw[sub.element * sub.size : (sub.element + 1) * sub.size]

    def _write(self, index: int, subindex: int, od: object, data: bytes) -> None:
        try:
            if (group := self._whole(index)) is not None:
                self._front.write(group.name, unpack(group, bytes(data), "little"))
            elif (index, subindex) in self._subs:
                self._write_one(self._subs[index, subindex], bytes(data))
        except RefusedError as refused:
            raise SdoAbortedError(refused.refusal.canopen) from refused
        except BusError as error:
            raise SdoAbortedError(Refusal.LIMIT.canopen) from error

    def _write_one(self, sub: SubObject, data: bytes) -> None:
        """Objects one by one; the group acts when its last one is written."""
        staged = self._staged.setdefault(sub.group.name, {})
        staged[sub.obj.name] = decode(sub.obj, data.ljust(sub.obj.size, b"\0"), "little")
        if sub == self._last[sub.group.name]:
            del self._staged[sub.group.name]
            if len(staged) != len(self._objects.pieces(sub.group.name)):
                raise RefusedError(Refusal.LIMIT, f"{sub.group.name} is incomplete")
            self._front.write(sub.group.name, staged)

    # ---- process data

    def _on_beat(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        if self._state != OPERATIONAL:
            return
        with suppress(BusError, RefusedError):
            token, count = beat_of(bytes(data))
            self._write_group("beat", {"token": token, "count": count})

    def _on_stop(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        if self._state == OPERATIONAL:
            self._front.device.stop(stop_of(bytes(data)))

    def _on_nmt(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        if len(data) < 2 or data[1] not in (0, self._node_id):
            return
        if data[0] in _NMT_STOP:
            self._front.device.stop()
        if not self._self_starting:
            self._state = _NMT_STATES.get(data[0], self._state)

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
            if self._state == OPERATIONAL:
                self._network.send_message(self._objects.progress_cob_id + self._node_id, progress_bytes(progress))


def _leave(network: canopen.Network) -> None:
    with suppress(Exception):  # what made it fail is raised once more
        network.disconnect()
