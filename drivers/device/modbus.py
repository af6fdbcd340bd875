"""Modbus servers of the device: TCP, TLS, and RTU on a serial line. One thread for each connection.

The frames are taken apart here and not by pymodbus's server: that one answers a single frame of what it receives
at once, and copies every register through objects (docs/decisions). The drivers use pymodbus's client, an
independent reading of the same protocol.
"""

from __future__ import annotations

import os
import select
import socket
import ssl
import struct
import threading
import time
from contextlib import suppress

from pymodbus.framer.rtu import FramerRTU

from drivers.device.accepting import accepted
from drivers.device.faults import ModbusSpoiler, SpoiltConversation, Wire
from drivers.device.front import DeviceFront
from drivers.device.registers import RegisterSession
from drivers.errors import ControllerError
from drivers.modbus.map import DEFAULT_MAP, RegisterMap
from sim.errors import reason

MAX_PDU = 253
_HEADER = struct.Struct(">HHHB")
GATEWAY_TARGET_FAILED = 0x0B
BURST_BYTES = 16
"""Of a throttled line: so many bytes come at once, as from the FIFO of a UART."""


class TcpServer:
    """Modbus TCP, or TLS when a context is given, on its own threads until `close`.

    Parameters
    ----------
    port
        0 takes a free one; ``port`` then says which.
    context
        Of TLS; it says whether hosts must show a certificate.
    spoiler
        Faults on purpose.

    Raises
    ------
    ControllerError
        The address cannot be listened on.
    """

    def __init__(
        self,
        front: DeviceFront,
        host: str = "127.0.0.1",
        port: int = 0,
        unit: int = 1,
        registers: RegisterMap = DEFAULT_MAP,
        context: ssl.SSLContext | None = None,
        spoiler: ModbusSpoiler | None = None,
    ) -> None:
        self._front, self._unit, self._map, self._context, self._spoiler = front, unit, registers, context, spoiler
        self._connections: set[socket.socket] = set()
        self._closing = threading.Event()
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise ControllerError(f"cannot listen on {host}:{port}: {reason(error)}; choose another port") from error
        self._listener.settimeout(0.1)
        self.port: int = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._accept, name="modbus", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening and drop every connection; safe twice."""
        self._closing.set()
        self._thread.join(timeout=2.0)
        self._listener.close()
        for connection in list(self._connections):
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._front.close()

    def _accept(self) -> None:
        for connection in accepted(self._listener, self._closing):
            threading.Thread(target=self._serve, args=(connection,), name="modbus-host", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            if self._context is not None:
                connection.settimeout(5.0)
                connection = self._context.wrap_socket(connection, server_side=True)
                connection.settimeout(None)
            self._connections.add(connection)
            self._converse(connection)
        except (OSError, ValueError):
            pass  # the host went away, or is not one of ours: its lease and the watchdog see to the rest
        finally:
            self._connections.discard(connection)
            connection.close()

    def _converse(self, connection: socket.socket) -> None:
        session = RegisterSession(self._front, self._map)
        spoilt = self._spoilt(connection, session) if self._spoiler else None
        buffer = b""
        while chunk := connection.recv(4096):
            buffer = buffer + chunk if buffer else chunk
            while len(buffer) >= 7:
                _, protocol, length, _ = _HEADER.unpack_from(buffer)
                if protocol != 0 or not 2 <= length <= MAX_PDU + 1:
                    return  # out of step: only a new connection helps
                if len(buffer) < 6 + length:
                    break
                frame, buffer = buffer[: 6 + length], buffer[6 + length :]
                if spoilt is None:
                    connection.sendall(self._answer(session, frame))
                elif not spoilt.take(frame):
                    return

    def _answer(self, session: RegisterSession, frame: bytes) -> bytes:
        """The answer's frame to a request's."""
        unit = frame[6]
        if unit != self._unit and unit not in (0, 255):
            return _tcp_frame(frame, bytes([frame[7] | 0x80, GATEWAY_TARGET_FAILED]))
        return _tcp_frame(frame, session.answer(frame[7:]))

    def _spoilt(self, connection: socket.socket, session: RegisterSession) -> SpoiltConversation:
        assert self._spoiler is not None
        return SpoiltConversation(
            self._spoiler,
            _TCP_WIRE,
            lambda frame: self._answer(session, frame),
            connection.sendall,
            RegisterSession(self._front, self._map).answer,
        )


def _tcp_frame(request: bytes, pdu: bytes) -> bytes:
    return request[:4] + (len(pdu) + 1).to_bytes(2, "big") + request[6:7] + pdu


_TCP_WIRE = Wire(function_at=7, covered_from=6, reply=_tcp_frame, connected=True)


class RtuServer:
    """Modbus RTU on an open serial port or pseudo-terminal (a file descriptor), on its own thread until `close`.

    Parameters
    ----------
    spoiler
        Faults on purpose.
    bytes_per_s
        To which a pseudo-terminal is held back, requests and answers; None does not.
    """

    def __init__(
        self,
        front: DeviceFront,
        fd: int,
        unit: int = 1,
        registers: RegisterMap = DEFAULT_MAP,
        spoiler: ModbusSpoiler | None = None,
        bytes_per_s: float | None = None,
    ) -> None:
        self._front, self._fd, self._unit, self._bytes_per_s = front, fd, unit, bytes_per_s
        self._free_at = 0.0
        self._session = RegisterSession(front, registers)
        self._spoilt: SpoiltConversation | None = None
        if spoiler is not None:
            other = RegisterSession(front, registers).answer
            self._spoilt = SpoiltConversation(spoiler, _RTU_WIRE, self._answer, self._send, other)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="modbus-rtu", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering; the port stays open. Safe twice."""
        self._closing.set()
        self._thread.join(timeout=2.0)
        self._front.close()

    def _run(self) -> None:
        buffer = bytearray()
        while not self._closing.is_set():
            try:
                # A frame ends in silence: what is incomplete after 50 ms is noise, and the host will ask again.
                ready = select.select([self._fd], [], [], 0.05)[0]
                chunk = os.read(self._fd, 512) if ready else b""
            except OSError:
                return
            if not chunk:
                buffer.clear()
                continue
            buffer += chunk
            # Requests that a host said again while this machine stood still come at once: one that was left for the
            # next time would be answered in place of the next one, and so on.
            while (size := _request_size(buffer)) is not None and len(buffer) >= size:
                frame = bytes(buffer[:size])
                del buffer[:size]
                self._serve(frame)

    def _serve(self, frame: bytes) -> None:
        self._carry(len(frame))
        if self._spoilt is not None:
            self._spoilt.take(frame)
        elif answer := self._answer(frame):
            self._send(answer)

    def _answer(self, frame: bytes) -> bytes:
        """The answer's frame; none to what was corrupted, or meant for another unit."""
        if frame[0] != self._unit or not _crc_fits(frame):
            return b""
        return _rtu_frame(frame, self._session.answer(frame[1:-2]))

    def _send(self, raw: bytes) -> None:
        burst = len(raw) if self._bytes_per_s is None else BURST_BYTES
        while raw:
            self._carry(len(raw[:burst]))
            select.select([], [self._fd], [], 1.0)
            raw = raw[os.write(self._fd, raw[:burst]) :]

    def _carry(self, size: int) -> None:
        """Wait as long as a throttled line takes for that many bytes."""
        if self._bytes_per_s is not None:
            now = time.monotonic()
            self._free_at = max(self._free_at, now) + size / self._bytes_per_s
            time.sleep(self._free_at - now)


def _rtu_frame(request: bytes, pdu: bytes) -> bytes:
    answer = request[:1] + pdu
    return answer + struct.pack(">H", FramerRTU.compute_CRC(answer))


_RTU_WIRE = Wire(function_at=1, covered_from=0, reply=_rtu_frame, connected=False)


def _request_size(buffer: bytearray) -> int | None:
    """Length of the request that the buffer begins with; None while that is not known."""
    if len(buffer) < 2:
        return None
    if buffer[1] in (15, 16):
        return 9 + buffer[6] if len(buffer) >= 7 else None
    return 8


def _crc_fits(frame: bytes) -> bool:
    return struct.pack(">H", FramerRTU.compute_CRC(frame[:-2])) == frame[-2:]
