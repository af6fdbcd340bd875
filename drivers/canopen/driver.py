"""A controller on CANopen: SDO for groups and results, PDO for heartbeat, stop and progress."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from drivers.amplitude import amplitudes
from drivers.canopen.bus import has_a_line, open_network
from drivers.canopen.codec import (
    BOOT_UP,
    NMT_COB,
    NMT_START,
    OPERATIONAL,
    PRE_OPERATIONAL,
    Progress,
    beat_bytes,
    progress_of,
    stop_bytes,
)
from drivers.canopen.dictionary import object_dictionary
from drivers.canopen.map import DEFAULT_MAP, SEGMENT_BYTES, WHOLE_INDEX, ObjectMap
from drivers.canopen.upload import UploadingSdoClient
from drivers.errors import BusError
from drivers.link import Link, RefusedError, go_on
from drivers.objects import BY_NAME, Outcome, Refusal, Type
from drivers.packing import Order, Value, Values, decode, encode, pack, unpack, with_crc
from sim.errors import reason

T = TypeVar("T")
SDO_TIMEOUT_S = 0.3
PROGRESS_TIMEOUT_S = 0.3
"""After this long without a progress frame the status is read: the frame may have been lost."""
SEGMENT_TRIES = 5
SEGMENTS_S = 30.0
"""After this long the next segment that fails ends a raw record for now; what has come is kept for the next time."""
SILENT_S = 5.0
"""A node that was heard within this time is on: what does not come from it was lost."""
BLOCK_BYTES = 56
"""From this size on a block upload needs fewer frames than a segmented one."""
RECORD_SHARE = 0.45
"""Of a line's bits, those that are a raw record's: seven bytes of a frame that has some 123 with its stuffing."""
STOP_COPIES = 3
"""A stop has no answer; it may be said more than once."""
_OUT_OF_STEP = (0x0503, 0x0504)
"""Upper half of the aborts of a server that got other frames than it waited for (CiA 301, table 22)."""
_REFUSALS = {refusal.canopen: refusal for refusal in Refusal}


class CanopenLinks:
    """Connections to one node. They share one CAN interface, which is opened again after it failed.

    Parameters
    ----------
    address
        As in `drivers.canopen.bus`.
    bitrate
        Of the line, where it is known: it tells how long a raw record takes.
    objects
        Where the node's objects are.
    """

    def __init__(
        self, address: str, node_id: int, bitrate: int | None = None, objects: ObjectMap = DEFAULT_MAP
    ) -> None:
        self.objects = objects
        self.description = f"canopen://{address}?node={node_id}"
        self.node_id = node_id
        self._address = address
        self._lock = threading.RLock()
        self._network: canopen.Network | None = None
        self._state: int | None = None
        """Of network management, as the node has told it last; None where it has not, or was started since."""
        self._node: Any = None
        self.raw_bytes_per_s = RECORD_SHARE * bitrate / 8 if bitrate and has_a_line(address) else None
        self.silence_s = 0.0  # a heartbeat needs no answer, and passes any transfer by
        self.amplitudes = amplitudes(s.obj for s in objects.subs if s.obj.name == "amplitude_a")
        self.changed = threading.Event()
        self.progress: Progress | None = None
        self.heard_at: float | None = None
        """When the node last answered."""

    def link(self, urgent: bool = False) -> Link:
        """SDO connection, or, urgent, the one of process data."""
        return _PdoLink(self) if urgent else _SdoLink(self)

    def node(self) -> Any:
        """Remote node on the open network."""
        with self._lock:
            if self._network is None:
                network = open_network(self._address)
                node = canopen.RemoteNode(self.node_id, object_dictionary(self.node_id, self.objects))
                node.sdo = UploadingSdoClient(self.node_id, node.object_dictionary)
                node.sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S
                node.sdo_channels = [node.sdo]
                network.add_node(node)
                node.nmt.add_heartbeat_callback(self._on_state)
                network.subscribe(self.objects.progress_cob_id + self.node_id, self._on_progress)
                self._network, self._node = network, node
            return self._node

    def send(self, cob_id: int, data: bytes) -> None:
        """Send a frame.

        Raises
        ------
        BusError
            The bus failed.
        """
        try:
            self.node()
            network = self._network
            if network is None:
                raise BusError("the CAN bus was closed")
            network.send_message(cob_id, data)
        except (can.CanError, OSError, RuntimeError) as error:
            self.close()
            raise BusError(f"the CAN bus failed: {reason(error)}") from error

    def start_waiting_node(self) -> None:
        """Start the node if it has told that it waits for that, in its heartbeat or at its boot-up.

        Until then it takes no process data (CiA 301, 7.3.2.2.2). Other nodes are left as they are. It is told once for
        each time that the node says so: a command of network management has no answer.
        """
        if self._state not in (BOOT_UP, PRE_OPERATIONAL):
            return
        self._state = None
        self.send(NMT_COB, bytes([NMT_START, self.node_id]))

    @property
    def operational(self) -> bool:
        """Whether the node was last heard to be operational."""
        return self._state == OPERATIONAL

    def close(self) -> None:
        """Leave the bus; safe twice. The next call opens it again."""
        with self._lock:
            network, self._network, self._node = self._network, None, None
        if network is not None:
            with suppress(Exception):
                network.disconnect()

    def _on_state(self, state: int) -> None:
        self._state = state

    def _on_progress(self, cob_id: int, data: bytearray, timestamp: float) -> None:
        with suppress(BusError):
            self.progress = progress_of(bytes(data))
            if self.progress.outcome != Outcome.UNDER_WAY:
                self.changed.set()


class _SdoLink:
    """Groups and results by SDO."""

    order: Order = "little"

    def __init__(self, links: CanopenLinks) -> None:
        self._links = links
        self._objects = links.objects
        self._failures = 0
        self._transfers = self._failed_transfers = 0
        self._in_segments = False
        self._segments: tuple[int, list[bytes]] = (0, [])
        """Of which result, and those of its raw record that are here."""
        self._names = {WHOLE_INDEX + group.index: group.name for group in BY_NAME.values()} | {
            links.objects.lockin_index: "lock-in result",
            links.objects.raw_index: "raw record",
            links.objects.segment_index: "part of a raw record",
        }

    def read(self, group: str) -> dict[str, Value]:
        of = BY_NAME[group]
        if group not in self._objects.whole:
            return self._read_pieces(group)
        index = WHOLE_INDEX + of.index
        if of.size >= BLOCK_BYTES:
            return unpack(of, self._block(index, of.size), self.order)
        return unpack(of, self._upload(index, 0), self.order)

    def write(self, group: str, values: Values) -> None:
        of = BY_NAME[group]
        if group == "tone":
            self._links.changed.clear()
        if group not in self._objects.whole:
            self._write_pieces(group, with_crc(of, values))
            return
        self._download(WHOLE_INDEX + of.index, 0, pack(of, values, self.order))

    def _read_pieces(self, group: str) -> dict[str, Value]:
        """A group of a rig's own map, object by object."""
        values: dict[str, Value] = {}
        for obj, subs in self._objects.pieces(group):
            raw = b"".join(self._upload(s.index, s.subindex) for s in subs)
            if obj.type is Type.TEXT:
                raw = raw[: obj.size].ljust(obj.size, b"\0")  # a vendor's text may be as long as it likes
            if len(raw) != obj.size:
                raise BusError(f"{group}.{obj.name} has {len(raw)} bytes instead of {obj.size}")
            values[obj.name] = decode(obj, raw, self.order)
        return values

    def _write_pieces(self, group: str, sealed: Values) -> None:
        """The same for a command; it acts when its last object is written."""
        for obj, subs in self._objects.pieces(group):
            raw = encode(obj, sealed[obj.name], self.order)
            for k, sub in enumerate(subs):
                self._download(sub.index, sub.subindex, raw[k * sub.size : (k + 1) * sub.size])

    def _upload(self, index: int, subindex: int) -> bytes:
        return self._transfer(index, lambda sdo: bytes(sdo.upload(index, subindex)))

    def _download(self, index: int, subindex: int, raw: bytes) -> None:
        self._transfer(index, lambda sdo: sdo.download(index, subindex, raw))

    def lockin_payload(self, size: int) -> bytes:
        return self._block(self._objects.lockin_index, size)

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        """The whole in one transfer; on a bus on which that has failed, segment by segment, each with its own CRC."""
        if not self._in_segments:
            with suppress(BusError, RefusedError):
                return self._block(self._objects.raw_index, size, between)
            self._in_segments = True
        if self._segments[0] != result:
            self._segments = (result, [])
        parts = self._segments[1]
        deadline, tried = time.monotonic() + SEGMENTS_S, 0
        while (segment := len(parts)) * SEGMENT_BYTES < size:
            between()
            try:
                parts.append(self._segment(result, segment, min(size - SEGMENT_BYTES * segment, SEGMENT_BYTES)))
                tried = 0
            except (BusError, RefusedError):
                tried += 1
                if tried == SEGMENT_TRIES or time.monotonic() > deadline:
                    raise
        self._segments = (0, [])  # should they not be right together, all of them are asked for again
        return b"".join(parts)

    def _segment(self, result: int, segment: int, size: int) -> bytes:
        self.write("window", {"result": result, "segment": segment})
        return self._block(self._objects.segment_index, size)

    def wait_for_change(self, seconds: float) -> int | None:
        if not self._links.changed.wait(max(seconds, PROGRESS_TIMEOUT_S)):
            return None
        self._links.changed.clear()
        progress = self._links.progress
        return progress.command if progress is not None and progress.outcome == Outcome.DONE else None

    def close(self) -> None:
        self._links.close()

    def _block(self, index: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        raw = self._transfer(index, lambda sdo: bytes(sdo.block_upload(index, 0, between)))
        if len(raw) != size:
            raise BusError(f"an SDO block transfer gave {len(raw)} bytes instead of {size}")
        return raw

    def _transfer(self, index: int, action: Callable[[Any], T]) -> T:
        self._transfers += 1
        try:
            sdo = self._links.node().sdo
            try:
                done = action(sdo)
            finally:
                self._links.heard_at = sdo.heard_at or self._links.heard_at
        except SdoAbortedError as aborted:
            if aborted.code in _REFUSALS:
                raise RefusedError(_REFUSALS[aborted.code], self._refused(index, aborted)) from aborted
            self._failed_transfers += 1
            raise BusError(self._aborted(index, aborted)) from aborted
        except (SdoCommunicationError, SdoError, struct.error) as error:  # struct.error: a frame was cut short
            self._failed_transfers += 1
            self._failed()
            raise BusError(self._lost(index, reason(error))) from error
        except BusError:  # it could not be opened
            raise
        except (can.CanError, OSError, RuntimeError, ValueError, IndexError) as error:
            self._links.close()
            raise BusError(f"the CAN bus failed: {reason(error)}") from error
        self._failures = 0
        return done

    def _lost(self, index: int, why: str) -> str:
        """What did not come of a transfer, why that may be, and what to see to."""
        node, heard_at = self._links.node_id, self._links.heard_at
        told = f"the SDO transfer of {self._named(index)} with node {node} failed: {why}"
        if heard_at is None:
            return f"{told}; see that the controller is on, and that bus and node are right"
        silent_s = time.monotonic() - heard_at
        if silent_s > SILENT_S:
            return f"{told}; silent for {silent_s:.0f} s: see that the controller is still on, and the bus whole"
        return (
            f"{told}; the node answers, so that frames are lost on the way ({self._failed_transfers} of "
            f"{self._transfers} transfers failed): see to termination, wiring, bit rate and load of the CAN bus"
        )

    def _named(self, index: int) -> str:
        """An object by its index, and by what it is to us where that has a name."""
        return f"object 0x{index:04X}" + (f" ({self._names[index]})" if index in self._names else "")

    def _aborted(self, index: int, aborted: SdoAbortedError) -> str:
        if aborted.code >> 16 in _OUT_OF_STEP:
            return self._lost(index, f"the node broke it off (SDO abort {_code(aborted)})")
        return self._refused(index, aborted)

    def _refused(self, index: int, aborted: SdoAbortedError) -> str:
        told = f"node {self._links.node_id} refused {self._named(index)} (SDO abort {_code(aborted)})"
        if _REFUSALS.get(aborted.code, Refusal.ADDRESS) is not Refusal.ADDRESS:
            return told
        return f"{told}; if its objects are a vendor's own, name them with map="

    def _failed(self) -> None:
        """After a second failure in a row the interface itself may be dead: open it anew."""
        self._failures += 1
        if self._failures % 2 == 0:
            self._links.close()
        else:
            time.sleep(0.01)  # what is left of the broken transfer passes by


def _code(aborted: SdoAbortedError) -> str:
    return str(aborted).removeprefix("Code ")


class _PdoLink:
    """Heartbeat and stop as process data: they need no answer, and pass any transfer by."""

    order: Order = "little"

    def __init__(self, links: CanopenLinks) -> None:
        self._links = links
        self._started = False

    def write(self, group: str, values: Values) -> None:
        token, objects, node = int(values["token"]), self._links.objects, self._links.node_id  # type: ignore[arg-type]
        if group == "beat":
            self._start()
            self._links.send(objects.beat_cob_id + node, beat_bytes(token, int(values["count"])))  # type: ignore[arg-type]
        elif group == "stop":
            for copy in range(STOP_COPIES):
                if copy:
                    time.sleep(0.002)
                self._links.send(objects.stop_cob_id + node, stop_bytes(token))
        else:
            raise BusError(f"{group} is not a process data object")

    def _start(self) -> None:
        """Start a node that waits; not one that was operational under this lease, for whoever took it out of that."""
        self._started |= self._links.operational
        if not self._started:
            self._links.start_waiting_node()

    def read(self, group: str) -> dict[str, Value]:
        raise BusError("process data cannot be asked for")

    def lockin_payload(self, size: int) -> bytes:
        raise BusError("process data cannot be asked for")

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        raise BusError("process data cannot be asked for")

    def wait_for_change(self, seconds: float) -> int | None:
        self._links.changed.wait(seconds)
        return None

    def close(self) -> None:
        """The interface belongs to the measuring connection."""
