"""SDO block upload (CiA 301, 7.2.4.3.13 and on) that answers from the receiving thread.

Between two blocks a line is idle until the host has answered. The library's client gets every frame through a queue in
another thread; here the thread that receives a block's last frame answers it.
"""

from __future__ import annotations

import binascii
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import can
from canopen import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.constants import (
    ABORT_CRC_ERROR,
    ABORT_GENERAL_ERROR,
    ABORT_TIMED_OUT,
    BLOCK_TRANSFER_RESPONSE,
    CRC_SUPPORTED,
    END_BLOCK_TRANSFER,
    INITIATE_BLOCK_TRANSFER,
    NO_MORE_BLOCKS,
    REQUEST_BLOCK_UPLOAD,
    RESPONSE_ABORTED,
    RESPONSE_BLOCK_UPLOAD,
    START_BLOCK_UPLOAD,
)
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.link import go_on

BLOCK_SEGMENTS = 127
SEGMENT_BYTES = 7
REMINDERS = 3
"""How often in a row a silent server is reminded,"""
REMINDERS_IN_ALL = 50
"""and how often in one upload: a line that loses so much is better asked for smaller parts."""
LOOK_S = 0.1
"""How often whoever waits for an upload may give it up."""
QUIET_S, LONGEST_PASSING_S = 0.05, 2.0
"""Without a frame for so long, the block that a server was sending has passed; and how long that may take."""
_COMMAND = 0xE0


class BlockUpload:
    """One upload, from the start of its first block on. Pure but for ``send``.

    Parameters
    ----------
    send
        Sends a request of eight bytes.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._lock = threading.Lock()
        self._segments: list[bytes] = []
        self._next = 1
        self._heard = False
        """Whether a segment has come since the last answer: the server has sent the block, then."""
        self._answer = bytes([REQUEST_BLOCK_UPLOAD | START_BLOCK_UPLOAD]) + bytes(7)
        self._all_here = False
        self.over = threading.Event()
        self.failure: Exception | None = None
        self.data = b""
        """What was uploaded, once it is over without failure."""

    @property
    def received(self) -> int:
        """Segments that are here."""
        return len(self._segments)

    def start(self) -> None:
        """Ask for the first block."""
        self._send(self._answer)

    def take(self, frame: bytes) -> None:
        """A frame of the server."""
        with self._lock:
            if self.over.is_set() or len(frame) != 8:
                return  # what was cut short counts as lost
            try:
                if frame[0] == RESPONSE_ABORTED:
                    raise SdoAbortedError(int.from_bytes(frame[4:8], "little"))
                if self._all_here:
                    self._take_end(frame)
                else:
                    self._take_segment(frame)
            except Exception as error:
                self._fail(error)

    def remind(self) -> None:
        """Answer again: the server is silent, so that the answer, or the end of a block, was lost."""
        with self._lock:
            if self.over.is_set():
                return
            try:
                if self._heard and not self._all_here:
                    self._acknowledge()
                else:
                    self._send(self._answer)
            except Exception as error:
                self._fail(error)

    def _take_segment(self, frame: bytes) -> None:
        number, last = frame[0] & 0x7F, bool(frame[0] & NO_MORE_BLOCKS)
        heard, self._heard = self._heard, True
        if number == self._next:
            self._segments.append(frame[1:])
            self._next += 1
            self._all_here = last
            if last or number == BLOCK_SEGMENTS:
                self._acknowledge()
        elif (last or number == BLOCK_SEGMENTS) and heard:  # one that comes alone is the last block's, once more
            self._acknowledge()  # the server goes on behind what is here: from the block's begin, if its first was lost

    def _acknowledge(self) -> None:
        received, self._next, self._heard = self._next - 1, 1, False
        head = bytes([REQUEST_BLOCK_UPLOAD | BLOCK_TRANSFER_RESPONSE, received, BLOCK_SEGMENTS])
        self._answer = head + bytes(5)
        self._send(self._answer)

    def _take_end(self, frame: bytes) -> None:
        if frame[0] & (_COMMAND | 0x03) != RESPONSE_BLOCK_UPLOAD | END_BLOCK_TRANSFER:
            return
        unused, (crc,) = (frame[0] >> 2) & 0x07, struct.unpack_from("<H", frame, 1)
        data = b"".join(self._segments)
        data = data[: len(data) - unused]
        if binascii.crc_hqx(data, 0) != crc:
            self._send(_abort(ABORT_CRC_ERROR))
            raise SdoCommunicationError("the CRC of the block upload is wrong")
        self._send(bytes([REQUEST_BLOCK_UPLOAD | END_BLOCK_TRANSFER]) + bytes(7))
        self.data = data
        self.over.set()

    def _fail(self, error: Exception) -> None:
        self.failure = error
        self.over.set()


class UploadingSdoClient(SdoClient):
    """The library's SDO client with a block upload of our own."""

    def __init__(self, node_id: int, objects: ObjectDictionary) -> None:
        super().__init__(0x600 + node_id, 0x580 + node_id, objects)  # type: ignore[no-untyped-call]
        self._upload: BlockUpload | None = None
        self.heard_at: float | None = None
        """When the last frame of the server came, by the monotonic clock."""

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """A frame of the server, from the receiving thread."""
        self.heard_at = time.monotonic()
        upload = self._upload
        if upload is None:
            super().on_response(can_id, data, timestamp)  # type: ignore[no-untyped-call]
        else:
            upload.take(bytes(data))

    def block_upload(self, index: int, subindex: int, between: Callable[[], None] = go_on) -> bytes:
        """Content of an object; ``between`` is called meanwhile, and what it raises ends the upload.

        Raises
        ------
        SdoAbortedError
            The server refused.
        SdoCommunicationError
            The server fell silent, or the CRC is wrong.
        """
        command = REQUEST_BLOCK_UPLOAD | INITIATE_BLOCK_TRANSFER | CRC_SUPPORTED
        request = struct.pack("<BHBBBxx", command, index, subindex, BLOCK_SEGMENTS, 0)
        answer = self.request_response(request)  # type: ignore[no-untyped-call]
        if len(answer) != 8 or answer[0] & _COMMAND != RESPONSE_BLOCK_UPLOAD or answer[1:4] != request[1:4]:
            raise SdoCommunicationError("the answer belongs to another transfer")
        upload = self._upload = BlockUpload(self.send_request)
        try:
            upload.start()
            self._wait(upload, between)
        except BaseException:
            if not upload.over.is_set():  # by whoever waits, and not by the server or the line
                self._give_up(upload)
            raise
        finally:
            self._upload = None
        return upload.data

    def _wait(self, upload: BlockUpload, between: Callable[[], None]) -> None:
        silent, received, reminders = 0, 0, 0
        while not self._over(upload, between):
            silent = silent + 1 if upload.received == received else 0
            received = upload.received
            if silent > REMINDERS or reminders == REMINDERS_IN_ALL:
                upload.over.set()
                self.send_request(_abort(ABORT_TIMED_OUT))  # type: ignore[no-untyped-call]
                raise SdoCommunicationError("the server fell silent in a block upload")
            if silent:
                reminders += 1
                upload.remind()
        if upload.failure is not None:
            raise upload.failure

    def _over(self, upload: BlockUpload, between: Callable[[], None]) -> bool:
        """Whether it is over within the time that a server has for its next frames."""
        until = time.monotonic() + self.RESPONSE_TIMEOUT
        while not upload.over.wait(max(min(LOOK_S, until - time.monotonic()), 0.0)):
            between()
            if time.monotonic() >= until:
                return False
        return True

    def _give_up(self, upload: BlockUpload) -> None:
        """End an upload, and let the block pass that is on its way: the next request would take it for its answer."""
        upload.over.set()
        with suppress(can.CanError, OSError, RuntimeError):  # why it is given up is what is told
            self.send_request(_abort(ABORT_GENERAL_ERROR))  # type: ignore[no-untyped-call]
        longest = time.monotonic() + LONGEST_PASSING_S
        while (now := time.monotonic()) < longest and now - (self.heard_at or 0.0) < QUIET_S:
            time.sleep(QUIET_S / 5)


def _abort(code: int) -> bytes:
    return bytes([0x80, 0, 0, 0]) + code.to_bytes(4, "little")
