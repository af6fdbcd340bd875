"""A controller on Modbus TCP, TLS or RTU: `ModbusLink` is one connection, `ModbusLinks` makes them."""

from __future__ import annotations

import logging
import socket
import ssl
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from pymodbus import FramerType, ModbusException
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ConnectionException, ModbusIOException
from pymodbus.pdu import ModbusPDU

from drivers.amplitude import amplitudes
from drivers.errors import BusError
from drivers.link import RefusedError, go_on
from drivers.modbus.clients import TcpClient, TlsClient
from drivers.modbus.codec import entry_bytes, entry_value, read_request, read_response, to_bytes, to_registers
from drivers.modbus.framing import EIGHT_N_ONE, Framing
from drivers.modbus.map import DEFAULT_MAP, MAX_READ, MAX_WRITE, Entry, RegisterMap
from drivers.modbus.turns import Turns, Urgency
from drivers.objects import BY_NAME, Refusal
from drivers.packing import Order, Value, Values, check_crc, with_crc
from drivers.pages import SEGMENT_BYTES, SEGMENT_PAGES, page_data, paged_bytes
from sim.errors import reason

Client = Any  # TcpClient, TlsClient or ModbusSerialClient, which are only partly typed
Keep = Callable[[int, bytes], bytes]
TIMEOUT_S = 0.3
URGENT_TIMEOUT_S = 0.08
BLOCK_TRIES = 4
LATE_S = 0.06
"""Silence on a serial line after an answer to another request: others that are late have come by then, and a device
that gathers bytes begins anew."""
RECORD_SHARE = 0.75
"""Of a serial line's bytes, those that are a raw record's; the others are frames around it, heartbeats and pauses."""

# pymodbus writes every time-out to the log as an error; here they are raised, and counted, by those who retry.
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)

_FUNCTIONS = {"read_holding_registers": 3, "read_input_registers": 4, "write_registers": 16}
"""Function codes of pymodbus's verbs."""
_EXCEPTION = 0x80
_READ_BYTES, _WRITE_BYTES = 8 + 5 + 7, 9 + 8 + 7
"""Of request and answer without what they carry, with the silence of 3.5 bytes after each."""
_REFUSALS = {refusal.modbus: refusal for refusal in Refusal}
_EXCEPTIONS = {
    1: "it does not know what was asked for; see that this is the controller's address",
    10: "the gateway has no way to unit {unit}; correct unit, or set up the gateway",
    11: "behind the gateway no unit {unit} answers; correct unit, or see to that device",
}
"""What those mean that a controller of ours never gives (Modbus application protocol 1.1b3, 7)."""
_REACH = "see that the controller is on, and that its address and unit are right"
_OPEN = "see that it is there, that this user may use it, and that nobody else does"


class ModbusLink:
    """One connection, or one turn on a serial line. pymodbus's client underneath, one request at a time.

    Parameters
    ----------
    make_client
        Makes a client that is not yet connected.
    shared
        A line that several links share: each request waits for its turn, and a stop for none of the others.
    urgent
        Its requests go before those of links that are not.
    """

    order: Order = "big"

    def __init__(
        self,
        make_client: Callable[[], Client],
        registers: RegisterMap,
        unit: int,
        shared: Turns | None = None,
        urgent: bool = False,
    ) -> None:
        self._make_client = make_client
        self._map = registers
        self._unit = unit
        self._turns = shared or Turns()
        self._late_s = 0.0 if shared is None else LATE_S
        self._urgency = Urgency.BEAT if urgent else Urgency.DATA
        self._client: Client | None = None
        self._transaction = 0

    def read(self, group: str) -> dict[str, Value]:
        """Snapshot of a group."""
        values: dict[str, Value] = {}
        for span in self._map.spans(group, MAX_READ):
            address, count = span[0].address, span[-1].end - span[0].address
            answer = self._ask("read_holding_registers", address, count=count)
            values |= self._decoded(span, to_bytes(answer.registers))
        check_crc(BY_NAME[group], values)
        return values

    def _decoded(self, span: tuple[Entry, ...], raw: bytes) -> dict[str, Value]:
        start = span[0].address
        return {
            e.obj.name: entry_value(e, raw[2 * (e.address - start) : 2 * (e.end - start)], self._map.word_order)
            for e in span
        }

    def write(self, group: str, values: Values) -> None:
        """Carry out a command; it acts when its last object is written."""
        sealed = with_crc(BY_NAME[group], values)
        for span in self._map.spans(group, MAX_WRITE):
            raw = b"".join(entry_bytes(e, sealed[e.obj.name], self._map.word_order) for e in span)
            address, registers = span[0].address, to_registers(raw)
            with self._turns.turn(Urgency.STOP if group == "stop" else self._urgency):
                self._ask("write_registers", address, registers)

    def lockin_payload(self, size: int) -> bytes:
        """Lock-in payload from the data area."""
        return self._data(self._map.lockin_address, size, _as_it_is)

    def raw_record(self, result: int, size: int, between: Callable[[], None] = go_on) -> bytes:
        """Raw record, segment by segment through the data area; the CRC of every page is checked."""
        parts = []
        left = paged_bytes(size)
        for segment in range(-(-left // SEGMENT_BYTES)):
            self.write("window", {"result": result, "segment": segment})
            shown = min(left - SEGMENT_BYTES * segment, SEGMENT_BYTES)
            keep = _page_from(result, SEGMENT_PAGES * segment, between)
            parts.append(self._data(self._map.raw_address, shown, keep))
        return b"".join(parts)

    def wait_for_change(self, seconds: float) -> int | None:
        """Modbus devices never speak first: sleep."""
        time.sleep(seconds)
        return None

    def close(self) -> None:
        """Close the connection; the next call opens it again."""
        with self._turns.turn(self._urgency):
            client, self._client = self._client, None
            if client is not None:
                with suppress(Exception):
                    client.close()

    # ---- inside

    def _data(self, address: int, size: int, keep: Keep) -> bytes:
        """Bytes of a data area, block by block. A block that fails is asked for again, and not all that went before it.

        On a bus that loses one frame in a hundred, a record of a thousand blocks would never come through whole.
        ``keep`` is given each block and its number, and says what is kept of it.
        """
        registers = size // 2
        blocks = [(address + at, min(MAX_READ, registers - at)) for at in range(0, registers, MAX_READ)]
        parts: list[bytes] = []
        failed_at, failures = -1, 0
        while len(parts) < len(blocks):
            try:
                self._read_on(blocks, parts, keep)
            except (BusError, RefusedError):
                failures = failures + 1 if failed_at == len(parts) else 1
                failed_at = len(parts)
                if failures == BLOCK_TRIES:
                    raise
        return b"".join(parts)

    def _read_on(self, blocks: list[tuple[int, int]], parts: list[bytes], keep: Keep) -> None:
        """Read the blocks that are missing.

        On a serial line each has its own turn: heartbeat and stop go between two of them.
        """
        with self._turns.turn(self._urgency):
            client = self._connected()
            if not isinstance(client, ModbusSerialClient):
                self._read_fast(client, blocks, parts, keep)
        for address, count in blocks[len(parts) :]:
            parts.append(keep(len(parts), self._block(address, count)))

    def _read_fast(self, client: Client, blocks: list[tuple[int, int]], parts: list[bytes], keep: Keep) -> None:
        """All of them on a socket, which is this link's alone."""
        try:
            _set_kernel_timeout(client.socket, client.comm_params.timeout_connect)
            for address, count in blocks[len(parts) :]:
                parts.append(keep(len(parts), self._fast_block(client.socket, address, count)))
        except (OSError, BusError) as error:
            self.close()
            raise BusError(f"reading data failed: {reason(error)}") from error

    def _block(self, address: int, count: int) -> bytes:
        """One block of input registers."""
        return to_bytes(self._ask("read_input_registers", address, count=count).registers)

    def _fast_block(self, connection: socket.socket, address: int, count: int) -> bytes:
        """The same on a socket, past the library's way through objects, which takes longer than the network."""
        self._transaction = self._transaction % 0xFFFF + 1
        connection.sendall(read_request(self._transaction, self._unit, address, count))
        size = 9 + 2 * count
        frame = connection.recv(size)
        if not frame:
            raise BusError("the connection was closed")
        if len(frame) < size:
            frame = _received(connection, frame, size, self._unit)
        return read_response(frame, self._transaction, self._unit, count)

    def _connected(self) -> Client:
        if self._client is None:
            client = self._make_client()
            try:
                connected = client.connect()
            except (OSError, ValueError, ModbusException) as error:  # ValueError: a host that a socket cannot encode
                raise BusError(f"cannot connect: {reason(error)}; {_REACH}") from error
            if not connected:  # pymodbus keeps the reason to itself
                raise BusError(f"cannot open the serial port; {_OPEN}")
            connection = getattr(client, "socket", None)
            if isinstance(connection, socket.socket):
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._client = client
        return self._client

    def _ask(self, verb: str, *arguments: Any, **more: Any) -> ModbusPDU:
        """Answer to one request of pymodbus's client."""
        with self._turns.turn(self._urgency):
            client = self._connected()
            try:
                answer: ModbusPDU = getattr(client, verb)(*arguments, **more, device_id=self._unit)
            except ModbusIOException:
                self._fail(f"no answer from unit {self._unit}; {_REACH}")
            except ConnectionException:
                self._fail(f"the connection was closed without an answer from unit {self._unit}; {_REACH}")
            except (ModbusException, OSError, ValueError, IndexError) as error:
                self._fail(reason(error).removeprefix("Modbus Error: "))
            if not _answers(answer, verb, *arguments, **more):
                time.sleep(self._late_s)
                self._fail("the answer belongs to another request, or is cut short")
            if answer.isError():
                code = getattr(answer, "exception_code", 0)
                if code not in _REFUSALS:
                    self._fail(_exception(code, self._unit))
                raise RefusedError(_REFUSALS[code], f"Modbus exception {code}")
            return answer

    def _fail(self, message: str) -> Any:
        self.close()
        raise BusError(message)


def _answers(answer: ModbusPDU, verb: str, address: int, registers: list[int] | None = None, count: int = 0) -> bool:
    """Whether it is this request's: pymodbus takes any, and RTU has no numbers by which one that is late would show."""
    if answer.isError():
        return answer.function_code == _FUNCTIONS[verb] | _EXCEPTION
    if answer.function_code != _FUNCTIONS[verb]:
        return False
    if registers is None:
        return len(answer.registers) == count
    return (answer.address, answer.count) == (address, len(registers))


def _exception(code: int, unit: int) -> str:
    """What a device says, or a gateway in front of it, that is no refusal of the controller's."""
    told = _EXCEPTIONS.get(code, "").format(unit=unit)
    return f"the device answered with Modbus exception {code}" + (f": {told}" if told else "")


def _as_it_is(number: int, block: bytes) -> bytes:
    return block


def _page_from(result: int, first: int, between: Callable[[], None]) -> Keep:
    """Blocks that are the pages of a raw record from this one on."""

    def keep(number: int, block: bytes) -> bytes:
        between()
        return page_data(result, first + number, block)

    return keep


def _set_kernel_timeout(connection: socket.socket, seconds: float) -> None:
    """Time-outs by the kernel: Python's own would ask `poll` before every call, at a third of the speed.

    Not in TLS: a time-out of the kernel is nothing to OpenSSL, which would ask again for ever.
    """
    if isinstance(connection, ssl.SSLSocket):
        connection.settimeout(seconds)
        return
    connection.settimeout(None)
    interval = struct.pack("ll", int(seconds), round(seconds % 1 * 1e6))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, interval)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, interval)


def _received(connection: socket.socket, begun: bytes, size: int, unit: int) -> bytes:
    """Exactly ``size`` bytes of which some are there; an exception's frame is shorter, and told at once."""
    frame = bytearray(begun)
    while True:
        if len(frame) >= 9 and frame[7] & 0x80:
            raise BusError(_exception(frame[8], unit))
        if len(frame) >= size:
            return bytes(frame)
        chunk = connection.recv(size - len(frame))
        if not chunk:
            raise BusError("the connection was closed")
        frame += chunk


class ModbusLinks:
    """Connections to one Modbus device.

    Parameters
    ----------
    make_client
        Makes a client with the given time-out, s.
    bytes_per_s
        Of a serial line, which all links share, one request at a time; None for connections.
    """

    def __init__(
        self,
        description: str,
        make_client: Callable[[float], Client],
        unit: int = 1,
        registers: RegisterMap = DEFAULT_MAP,
        bytes_per_s: float | None = None,
    ) -> None:
        self.description = description
        self.raw_bytes_per_s = None if bytes_per_s is None else RECORD_SHARE * bytes_per_s
        self.silence_s = 0.0 if bytes_per_s is None else _silence_bytes(registers) / bytes_per_s
        self.amplitudes = amplitudes(e.obj for e in registers.entries if e.obj.name == "amplitude_a")
        self._make_client = make_client
        self._unit = unit
        self._map = registers
        self._line: _SharedLine | None = _SharedLine(make_client) if bytes_per_s is not None else None

    def link(self, urgent: bool = False) -> ModbusLink:
        """Connection that opens itself at the first call."""
        if self._line is not None:
            return ModbusLink(self._line.client, self._map, self._unit, self._line.turns, urgent)
        timeout = URGENT_TIMEOUT_S if urgent else TIMEOUT_S
        return ModbusLink(lambda: self._make_client(timeout), self._map, self._unit)

    def close(self) -> None:
        """Close the serial line."""
        if self._line is not None:
            self._line.close()


def _silence_bytes(registers: RegisterMap) -> float:
    """Of a heartbeat and of what goes in between while a tone plays, with the silence after each frame."""
    beats = [_WRITE_BYTES + 2 * (span[-1].end - span[0].address) for span in registers.spans("beat", MAX_WRITE)]
    looks = [_READ_BYTES + 2 * (span[-1].end - span[0].address) for span in registers.spans("status", MAX_READ)]
    return sum(beat + max(looks) for beat in beats)


class _SharedLine:
    """A serial line: one port for all links of this host, which take turns."""

    def __init__(self, make_client: Callable[[float], Client]) -> None:
        self.turns = Turns()
        self._client = make_client(TIMEOUT_S / 2)

    def client(self) -> Client:
        """The one client; it opens the port again when a link has closed it."""
        return self._client

    def close(self) -> None:
        """Close the port."""
        with self.turns.turn(Urgency.DATA):
            self._client.close()


def tcp_links(host: str, port: int, unit: int = 1, registers: RegisterMap = DEFAULT_MAP) -> ModbusLinks:
    """Links over plain TCP."""

    def client(timeout: float) -> Client:
        return TcpClient(host, port=port, timeout=timeout, retries=0)

    return ModbusLinks(f"modbus://{host}:{port}?unit={unit}", client, unit, registers)


def tls_links(
    host: str, port: int, context: ssl.SSLContext, unit: int = 1, registers: RegisterMap = DEFAULT_MAP
) -> ModbusLinks:
    """Links over TLS, with the certificates of the context."""

    def client(timeout: float) -> Client:
        return TlsClient(host, port, timeout, context)

    return ModbusLinks(f"modbuss://{host}:{port}?unit={unit}", client, unit, registers)


def rtu_links(
    port: str, baud: int, unit: int = 1, registers: RegisterMap = DEFAULT_MAP, frames: Framing = EIGHT_N_ONE
) -> ModbusLinks:
    """Links over a serial line, 8 bits."""

    def client(timeout: float) -> Client:
        return ModbusSerialClient(
            port,
            framer=FramerType.RTU,
            baudrate=baud,
            parity=frames.parity,
            stopbits=frames.stop_bits,
            timeout=max(timeout, 3 * 260 * 11 / baud),
            retries=0,
        )

    return ModbusLinks(f"modbus+rtu://{port}?unit={unit}", client, unit, registers, baud / frames.bits)
