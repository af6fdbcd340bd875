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

from drivers.canopen.bus import open_network
from drivers.canopen.codec import BEAT_COB, PROGRESS_COB, STOP_COB, Progress, beat_bytes, progress_of, stop_bytes
from drivers.canopen.map import LOCKIN_INDEX, RAW_INDEX, WHOLE_INDEX, object_dictionary
from drivers.errors import BusError
from drivers.link import Link, RefusedError
from drivers.objects import BY_NAME, Outcome, Refusal
from drivers.packing import Order, Value, Values, pack, unpack

T = TypeVar("T")
SDO_TIMEOUT_S = 0.3
PROGRESS_TIMEOUT_S = 0.3
"""After this long without a progress frame the status is read: the frame may have been lost."""
BLOCK_BYTES = 56
"""From this size on a block upload needs fewer frames than a segmented one."""
STOP_COPIES = 3
"""A stop has no answer; it may be said more than once."""
_REFUSALS = {refusal.canopen: refusal for refusal in Refusal}


class CanopenLinks:
    """Connections to one node. They share one CAN interface, which is opened again after it failed.

    Parameters
    ----------
    address
        As in `drivers.canopen.bus`.
    """

    def __init__(self, address: str, node_id: int, bitrate: int = 1_000_000) -> None:
        self.description = f"canopen://{address}?node={node_id}"
        self.node_id = node_id
        self._address, self._bitrate = address, bitrate
        self._lock = threading.RLock()
        self._network: canopen.Network | None = None
        self._node: Any = None
        self.changed = threading.Event()
        self.progress: Progress | None = None

    def link(self, urgent: bool = False) -> Link:
        """SDO connection, or, urgent, the one of process data."""
        return _PdoLink(self) if urgent else _SdoLink(self)

    def node(self) -> Any:
        """Remote node on the open network."""
        with self._lock:
            if self._network is None:
                network = open_network(self._address, self._bitrate)
                node = canopen.RemoteNode(self.node_id, object_dictionary(self.node_id))
                network.add_node(node)
                node.sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S
                network.subscribe(PROGRESS_COB + self.node_id, self._on_progress)
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
            network.send_message(cob_id + self.node_id, data)
        except (can.CanError, OSError, RuntimeError) as error:
            self.close()
            raise BusError(f"the CAN bus failed: {error}") from error

    def close(self) -> None:
        """Leave the bus; safe twice. The next call opens it again."""
        with self._lock:
            network, self._network, self._node = self._network, None, None
        if network is not None:
            with suppress(Exception):
                network.disconnect()

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
        self._failures = 0

    def read(self, group: str) -> dict[str, Value]:
        of = BY_NAME[group]
        index = WHOLE_INDEX + of.index
        if of.size >= BLOCK_BYTES:
            return unpack(of, self._block(index, of.size), self.order)
        return unpack(of, self._transfer(lambda sdo: bytes(sdo.upload(index, 0))), self.order)

    def write(self, group: str, values: Values) -> None:
        of = BY_NAME[group]
        if group == "tone":
            self._links.changed.clear()
        raw = pack(of, values, self.order)
        self._transfer(lambda sdo: sdo.download(WHOLE_INDEX + of.index, 0, raw))

    def lockin_payload(self, size: int) -> bytes:
        return self._block(LOCKIN_INDEX, size)

    def raw_record(self, result: int, size: int) -> bytes:
        return self._block(RAW_INDEX, size)

    def wait_for_change(self, seconds: float) -> int | None:
        if not self._links.changed.wait(max(seconds, PROGRESS_TIMEOUT_S)):
            return None
        self._links.changed.clear()
        progress = self._links.progress
        return progress.command if progress is not None and progress.outcome == Outcome.DONE else None

    def close(self) -> None:
        self._links.close()

    def _block(self, index: int, size: int) -> bytes:
        def upload(sdo: Any) -> bytes:
            with sdo.open(index, 0, "rb", buffering=0, block_transfer=True) as stream:
                return bytes(stream.readall())

        raw = self._transfer(upload)
        if len(raw) != size:
            raise BusError(f"an SDO block transfer gave {len(raw)} bytes instead of {size}")
        return raw

    def _transfer(self, action: Callable[[Any], T]) -> T:
        try:
            done = action(self._links.node().sdo)
        except SdoAbortedError as aborted:
            if aborted.code in _REFUSALS:
                raise RefusedError(_REFUSALS[aborted.code], f"SDO abort 0x{aborted.code:08X}") from aborted
            raise BusError(f"the SDO transfer was aborted: {aborted}") from aborted
        except (SdoCommunicationError, SdoError, struct.error, AttributeError) as error:
            # struct.error: a frame was cut short; AttributeError: how canopen 2.4's block upload meets a time-out
            self._failed()
            raise BusError(f"the SDO transfer failed: {error}") from error
        except (can.CanError, OSError, RuntimeError, ValueError, IndexError) as error:
            self._links.close()
            raise BusError(f"the CAN bus failed: {error}") from error
        self._failures = 0
        return done

    def _failed(self) -> None:
        """After a second failure in a row the interface itself may be dead: open it anew."""
        self._failures += 1
        if self._failures % 2 == 0:
            self._links.close()
        else:
            time.sleep(0.01)  # what is left of the broken transfer passes by


class _PdoLink:
    """Heartbeat and stop as process data: they need no answer, and pass any transfer by."""

    order: Order = "little"

    def __init__(self, links: CanopenLinks) -> None:
        self._links = links

    def write(self, group: str, values: Values) -> None:
        token = int(values["token"])  # type: ignore[arg-type]
        if group == "beat":
            self._links.send(BEAT_COB, beat_bytes(token, int(values["count"])))  # type: ignore[arg-type]
        elif group == "stop":
            for copy in range(STOP_COPIES):
                if copy:
                    time.sleep(0.002)
                self._links.send(STOP_COB, stop_bytes(token))
        else:
            raise BusError(f"{group} is not a process data object")

    def read(self, group: str) -> dict[str, Value]:
        raise BusError("process data cannot be asked for")

    def lockin_payload(self, size: int) -> bytes:
        raise BusError("process data cannot be asked for")

    def raw_record(self, result: int, size: int) -> bytes:
        raise BusError("process data cannot be asked for")

    def wait_for_change(self, seconds: float) -> int | None:
        self._links.changed.wait(seconds)
        return None

    def close(self) -> None:
        """The interface belongs to the measuring connection."""
