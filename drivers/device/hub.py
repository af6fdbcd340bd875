"""A CAN bus in software, for machines without one: a hub that speaks socketcand's protocol on TCP.

Every frame that a client sends reaches all others, in one order. With a bit rate, frames leave no faster than a
real bus would carry them; ``spoil`` may drop, change or add frames (`drivers.device.faults`).
"""

from __future__ import annotations

import ctypes
import heapq
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from drivers.device.accepting import accepted
from drivers.errors import ControllerError
from sim.errors import reason

GREETING_S = 0.02
"""After ``rawmode``, no frame for this long: python-can takes its answer for a single message."""
BACKLOG_BYTES = 1 << 20
"""A client that is farther behind is dropped: two seconds of a full line at 1 Mbit/s, beyond what the kernel holds."""
_FLUSH_S = 0.001
_PR_SET_TIMERSLACK = 29


@dataclass(frozen=True)
class Frame:
    """A classic CAN frame with an 11-bit identifier, or an error frame."""

    identifier: int
    data: bytes
    error: bool = False

    @property
    def bits(self) -> int:
        """Bits on the line, interframe space included, without stuffing."""
        return 47 + 8 * len(self.data)

    def line(self, now: float) -> bytes:
        """As socketcand tells it."""
        if self.error:
            return b"< error %08X %.6f >" % (self.identifier | 0x20000000, now)
        return b"< frame %03X %.6f %s >" % (self.identifier, now, self.data.hex().encode("ascii"))


Spoil = Callable[[Frame], list[tuple[float, Frame]]]
"""(frame) -> what reaches the others instead, each with a delay, s."""


@dataclass(eq=False)
class _Client:
    connection: socket.socket
    ready_at: float | None = None
    """When it may get frames; None before ``rawmode``."""
    backlog: bytearray = field(default_factory=bytearray)
    """What its connection has not taken yet."""
    lock: threading.Lock = field(default_factory=threading.Lock)

    def send(self, text: bytes) -> None:
        """Send as much as the connection takes without waiting, and keep the rest: one that stalls stops nobody else.

        Raises
        ------
        OSError
            The connection is gone, or the client does not keep up.
        """
        with self.lock:
            self.backlog += text
            with suppress(BlockingIOError):
                while self.backlog:
                    del self.backlog[: self.connection.send(self.backlog, socket.MSG_DONTWAIT)]
            if len(self.backlog) > BACKLOG_BYTES:
                raise TimeoutError("the client does not read what it asked for")


@dataclass(order=True)
class _Waiting:
    """A frame that has come in, and when it may go out at the earliest."""

    due: float
    number: int
    frame: Frame = field(compare=False)
    sender: _Client | None = field(compare=False)


class CanHub:
    """Runs on its own threads until `close`.

    Parameters
    ----------
    port
        0 takes a free one.
    bitrate
        Bits per second of the line; None does not hold frames back.
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 0, bitrate: int | None = None, spoil: Spoil | None = None
    ) -> None:
        self._bitrate, self._spoil = bitrate, spoil
        self._clients: list[_Client] = []
        self._closing = threading.Event()
        self._free_at = 0.0
        self._waiting: list[_Waiting] = []
        self._number = 0
        self._came = threading.Condition()
        self.bits = 0
        """Bits that the line has carried."""
        self.frames = 0
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise ControllerError(f"cannot listen on {host}:{port}: {reason(error)}; choose another port") from error
        self._listener.settimeout(0.1)
        self.port: int = self._listener.getsockname()[1]
        self.host = host
        self._threads = [threading.Thread(target=f, name="can-hub", daemon=True) for f in (self._accept, self._line)]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End; safe twice."""
        self._closing.set()
        with self._came:
            self._came.notify()
        for thread in self._threads:
            thread.join(timeout=2.0)
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()

    def send(self, frame: Frame) -> None:
        """Put a frame on the line from outside, as a further node would."""
        self._take([frame], None)

    # ---- one thread for each client: what it sends, with the time at which it came

    def _accept(self) -> None:
        for connection in accepted(self._listener, self._closing):
            client = _Client(connection)
            self._clients.append(client)
            threading.Thread(target=self._listen, args=(client,), name="can-node", daemon=True).start()

    def _listen(self, client: _Client) -> None:
        buffer = b""
        with suppress(OSError):
            client.send(b"< hi >")
            while chunk := client.connection.recv(65536):
                *messages, buffer = (buffer + chunk).split(b">")
                frames = []
                for message in messages:
                    words = message.strip(b"< ").split()
                    if words[:1] == [b"send"]:
                        with suppress(ValueError, IndexError):
                            data = bytes(int(word, 16) for word in words[3 : 3 + int(words[2], 16)])
                            frames.append(Frame(int(words[1], 16), data))
                    elif words[:1] in ([b"open"], [b"rawmode"]):
                        client.send(b"< ok >")
                        client.ready_at = time.monotonic() + GREETING_S if words[0] == b"rawmode" else None
                if frames:
                    self._take(frames, client)
        self._drop(client)

    def _take(self, frames: list[Frame], sender: _Client | None) -> None:
        now = time.monotonic()
        with self._came:
            for frame in frames:
                for delay, passed in [(0.0, frame)] if self._spoil is None else self._spoil(frame):
                    self._number += 1
                    heapq.heappush(self._waiting, _Waiting(now + delay, self._number, passed, sender))
            self._came.notify()

    # ---- the line: one frame after another

    def _line(self) -> None:
        _sharpen_sleep()
        while not self._closing.is_set():
            behind = [client for client in list(self._clients) if client.backlog]
            for client in behind:
                self._send(client, b"")
            with self._came:
                pause = self._waiting[0].due - time.monotonic() if self._waiting else 0.1
                if pause > 0:
                    self._came.wait(min(pause, _FLUSH_S) if behind else pause)
                    continue
                burst = [heapq.heappop(self._waiting)]
                self._clock(burst[0])
                # what one sender has ready goes out together, as long as that is not over a millisecond of the line
                while (
                    self._waiting
                    and self._waiting[0].sender is burst[0].sender
                    and self._waiting[0].due <= time.monotonic()
                    and self._free_at - time.monotonic() < 0.001
                    and len(burst) < 256
                ):
                    burst.append(heapq.heappop(self._waiting))
                    self._clock(burst[-1])
            ahead = self._free_at - time.monotonic()
            if self._bitrate is not None and ahead > 0:
                time.sleep(ahead)
            self._broadcast(burst)

    def _clock(self, waiting: _Waiting) -> None:
        self.bits += waiting.frame.bits
        self.frames += 1
        if self._bitrate is not None:
            self._free_at = max(self._free_at, waiting.due) + waiting.frame.bits / self._bitrate

    def _broadcast(self, burst: list[_Waiting]) -> None:
        stamp = time.time()
        text = b"".join(waiting.frame.line(stamp) for waiting in burst)
        now = time.monotonic()
        for client in list(self._clients):
            # a node that is only just opening its interface does not hear what passes
            if client is burst[0].sender or client.ready_at is None or client.ready_at > now:
                continue
            self._send(client, text)

    def _send(self, client: _Client, text: bytes) -> None:
        try:
            client.send(text)
        except OSError:
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        with suppress(ValueError):
            self._clients.remove(client)
        with suppress(OSError):
            client.connection.shutdown(socket.SHUT_RDWR)
        client.connection.close()


def _sharpen_sleep() -> None:
    """Let this thread sleep to a microsecond: Linux rounds up by fifty, half a frame at 1 Mbit/s."""
    with suppress(Exception):
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
