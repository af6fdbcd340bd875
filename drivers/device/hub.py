"""A CAN bus in software, for machines without one: a hub that speaks socketcand's protocol on TCP.

Every frame that a client sends reaches all others, in one order. With a bit rate, frames leave no faster than a
real bus would carry them; ``spoil`` may drop, change or add frames (`drivers.device.faults`).
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

from drivers.errors import ControllerError

GREETING_S = 0.02
"""After ``rawmode``, no frame for this long: python-can takes its answer for a single message."""


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
    buffer: bytes = b""
    ready_at: float | None = None
    """When it may get frames; None before ``rawmode``."""
    waiting: list[bytes] = field(default_factory=list)


class CanHub:
    """Runs on its own thread until `close`.

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
        self._later: list[tuple[float, Frame, _Client | None]] = []
        self.bits = 0
        """Bits that the line has carried."""
        self.frames = 0
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise ControllerError(f"cannot listen on {host}:{port}: {error}; choose another port") from error
        self.port: int = self._listener.getsockname()[1]
        self.host = host
        self._thread = threading.Thread(target=self._run, name="can-hub", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End; safe twice."""
        self._closing.set()
        self._thread.join(timeout=2.0)
        for client in self._clients:
            client.connection.close()
        self._listener.close()

    def send(self, frame: Frame) -> None:
        """Put a frame on the line from outside, as a further node would."""
        self._later.append((0.0, frame, None))

    def _run(self) -> None:
        while not self._closing.is_set():
            sockets = [self._listener, *(c.connection for c in self._clients)]
            timeout = 0.001 if self._later else 0.05
            for ready in select.select(sockets, [], [], timeout)[0]:
                if ready is self._listener:
                    connection, _ = self._listener.accept()
                    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    connection.sendall(b"< hi >")
                    self._clients.append(_Client(connection))
                else:
                    self._receive(next(c for c in self._clients if c.connection is ready))
            self._send_due()

    def _receive(self, client: _Client) -> None:
        try:
            chunk = client.connection.recv(65536)
        except OSError:
            chunk = b""
        if not chunk:
            self._drop(client)
            return
        *messages, client.buffer = (client.buffer + chunk).split(b">")
        frames = []
        for message in messages:
            words = message.strip(b"< ").split()
            if not words:
                continue
            if words[0] == b"send":
                with suppress(ValueError, IndexError):
                    data = bytes(int(word, 16) for word in words[3 : 3 + int(words[2], 16)])
                    frames.append(Frame(int(words[1], 16), data))
            elif words[0] in (b"open", b"rawmode"):
                client.connection.sendall(b"< ok >")
                client.ready_at = time.monotonic() + GREETING_S if words[0] == b"rawmode" else None
        self._pass_on(frames, client)

    def _pass_on(self, frames: list[Frame], sender: _Client | None) -> None:
        if self._spoil is None:
            self._carry(frames, sender)
            return
        now = time.monotonic()
        straight: list[Frame] = []
        for frame in frames:
            for delay, changed in self._spoil(frame):
                if delay:
                    self._later.append((now + delay, changed, sender))
                else:
                    straight.append(changed)
        self._carry(straight, sender)

    def _send_due(self) -> None:
        now = time.monotonic()
        due = [entry for entry in self._later if entry[0] <= now]
        if due:
            self._later = [entry for entry in self._later if entry[0] > now]
        for _, frame, sender in due:
            self._carry([frame], sender)
        for client in self._clients:
            if client.waiting and client.ready_at is not None and client.ready_at <= now:
                waiting, client.waiting = client.waiting, []
                self._send(client, b"".join(waiting))

    def _carry(self, frames: list[Frame], sender: _Client | None) -> None:
        """Send frames to all others, held back to the line's bit rate in bursts of about a millisecond."""
        burst: list[Frame] = []
        for frame in frames:
            burst.append(frame)
            self.bits += frame.bits
            self.frames += 1
            if self._bitrate is not None:
                now = time.monotonic()
                self._free_at = max(self._free_at, now) + frame.bits / self._bitrate
                if self._free_at - now > 0.001:
                    time.sleep(self._free_at - now)
                    self._broadcast(burst, sender)
                    burst = []
        self._broadcast(burst, sender)

    def _broadcast(self, frames: list[Frame], sender: _Client | None) -> None:
        if not frames:
            return
        now = time.time()
        text = b"".join(frame.line(now) for frame in frames)
        for client in list(self._clients):
            if client is sender or client.ready_at is None:
                continue
            if client.waiting or client.ready_at > time.monotonic():
                client.waiting.append(text)
            else:
                self._send(client, text)

    def _send(self, client: _Client, text: bytes) -> None:
        try:
            client.connection.sendall(text)
        except OSError:
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        client.connection.close()
        with suppress(ValueError):
            self._clients.remove(client)
