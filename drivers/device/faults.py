"""Faults on purpose, seeded: a proxy that spoils Modbus TCP frame by frame, and a spoiler for the CAN hub.

==============  ==============================  ==========================================================
fault           Modbus TCP                      CAN
==============  ==============================  ==========================================================
drop            the frame is lost               the frame is lost
delay           it comes late                   it comes late, after later ones
duplicate       it comes twice                  it comes twice
truncate        part of it, then the end of     its last bytes are missing
                the connection
corrupt         one bit is flipped              one bit is flipped
stale           an older answer comes instead   an older frame of the same identifier comes again
busy            "device busy", not asked        -
exception       a random exception, not asked   an SDO abort comes in
half_open       nothing passes any more, and    -
                the connection stays
disconnect      the connection ends             bus-off: nothing passes for a while
error_frame     -                               an error frame comes before it
second_master   another host asks in between    another master's SDO request comes in between
==============  ==============================  ==========================================================
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from drivers.device.hub import Frame
from drivers.errors import ControllerError

KINDS = (
    "drop", "delay", "duplicate", "truncate", "corrupt", "stale", "busy", "exception", "half_open", "disconnect",
    "error_frame", "second_master",
)  # fmt: skip
MAX_DELAY_S = 0.15
BUS_OFF_S = 0.3


@dataclass(frozen=True)
class FaultPlan:
    """How often which fault strikes: probability per frame."""

    seed: int
    rates: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.rates) - set(KINDS)):
            raise ControllerError(f"there is no fault {unknown[0]!r}; known are {', '.join(KINDS)}")
        if any(not 0 <= rate <= 1 for rate in self.rates.values()) or sum(self.rates.values()) > 1:
            raise ControllerError("the rates of faults are probabilities per frame, together at most 1")

    @classmethod
    def parse(cls, text: str, seed: int) -> FaultPlan:
        """Plan of ``drop=0.01,corrupt=0.02``, or of ``all=0.01``: every kind at that rate.

        >>> FaultPlan.parse("drop=0.01", 1).rates
        {'drop': 0.01}
        """
        rates: dict[str, float] = {}
        for pair in filter(None, text.split(",")):
            name, _, value = pair.partition("=")
            try:
                rate = float(value)
            except ValueError:
                raise ControllerError(f"cannot read the fault {pair!r}; write drop=0.01") from None
            rates |= dict.fromkeys(KINDS, rate) if name.strip() == "all" else {name.strip(): rate}
        return cls(seed, rates)


class Dice:
    """Draws faults; safe from any thread. ``struck`` counts them."""

    def __init__(self, plan: FaultPlan) -> None:
        self._generator = np.random.default_rng(plan.seed)
        self._lock = threading.Lock()
        self._kinds = list(plan.rates)
        self._edges = np.cumsum([plan.rates[kind] for kind in self._kinds])
        self.struck: Counter[str] = Counter()
        self.on = True

    def fault(self) -> str:
        """A kind, or empty."""
        with self._lock:
            if not self.on or not self._kinds:
                return ""
            k = int(np.searchsorted(self._edges, self._generator.random(), side="right"))
            if k == len(self._kinds):
                return ""
            self.struck[self._kinds[k]] += 1
            return self._kinds[k]

    def below(self, n: int) -> int:
        """Whole number from 0 to n - 1."""
        with self._lock:
            return int(self._generator.integers(n))

    def delay_s(self) -> float:
        """How late a frame comes."""
        with self._lock:
            return float(self._generator.uniform(0.0, MAX_DELAY_S))

    def flipped(self, raw: bytes, first: int = 0) -> bytes:
        """One bit flipped, not before byte ``first``."""
        if len(raw) <= first:
            return raw
        bit = self.below(8 * (len(raw) - first))
        spoilt = bytearray(raw)
        spoilt[first + bit // 8] ^= 1 << (bit % 8)
        return bytes(spoilt)


class FaultyTcp:
    """A proxy before a Modbus TCP device, on its own threads until `close`.

    Parameters
    ----------
    target
        Host and port of the device.
    """

    def __init__(self, target: tuple[str, int], plan: FaultPlan, host: str = "127.0.0.1", port: int = 0) -> None:
        self.dice = Dice(plan)
        self._target = target
        self._closing = threading.Event()
        try:
            self._listener = socket.create_server((host, port))
        except OSError as error:
            raise ControllerError(f"cannot listen on {host}:{port}: {error}; choose another port") from error
        self._listener.settimeout(0.1)
        self.port: int = self._listener.getsockname()[1]
        self._answers: dict[int, bytes] = {}
        self._pairs: list[_Pair] = []
        self._thread = threading.Thread(target=self._accept, name="faults", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End; safe twice."""
        self._closing.set()
        self._thread.join(timeout=2.0)
        self._listener.close()
        for pair in self._pairs:
            pair.end()

    def _accept(self) -> None:
        while not self._closing.is_set():
            with suppress(OSError):
                host, _ = self._listener.accept()
                host.settimeout(None)
                threading.Thread(target=self._carry, args=(host,), name="faulty-host", daemon=True).start()

    def _carry(self, host: socket.socket) -> None:
        try:
            device = socket.create_connection(self._target, timeout=2.0)
        except OSError:
            host.close()
            return
        device.settimeout(None)
        for one in (host, device):
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        pair = _Pair(self, host, device)
        self._pairs = [p for p in self._pairs if not p.ended] + [pair]
        threading.Thread(target=pair.pass_on, args=(device, host, False), daemon=True).start()
        pair.pass_on(host, device, True)

    def older_answer(self, frame: bytes) -> bytes:
        """An earlier answer to the same function, under this one's transaction number; and remember this one."""
        function = frame[7]
        older = self._answers.get(function, frame)
        if self.dice.below(4) == 0:
            self._answers[function] = frame
        return frame[:2] + older[2:]


class _Pair:
    """One connection through the proxy, frame by frame."""

    def __init__(self, proxy: FaultyTcp, host: socket.socket, device: socket.socket) -> None:
        self._proxy, self._host, self._device = proxy, host, device
        self._deaf = False
        self.ended = False

    def pass_on(self, source: socket.socket, sink: socket.socket, request: bool) -> None:
        buffer = b""
        try:
            while chunk := source.recv(65536):
                buffer += chunk
                while len(buffer) >= 7:
                    size = 6 + struct.unpack_from(">H", buffer, 4)[0]
                    if len(buffer) < size:
                        break
                    frame, buffer = buffer[:size], buffer[size:]
                    if not self._deaf and not self._frame(frame, sink, request):
                        return
        except (OSError, struct.error):
            pass
        finally:
            self.end()

    def _frame(self, frame: bytes, sink: socket.socket, request: bool) -> bool:
        """Pass a frame on, or what a fault makes of it; False when the connection has ended."""
        dice = self._proxy.dice
        fault = dice.fault()
        if not request:
            stale = self._proxy.older_answer(frame)
            frame = stale if fault == "stale" else frame
        if fault == "delay":
            time.sleep(dice.delay_s())
        elif fault == "corrupt":
            frame = dice.flipped(frame, first=6)
        elif fault == "duplicate":
            frame = frame + frame
        elif fault == "truncate":
            sink.sendall(frame[: 1 + dice.below(len(frame) - 1)])
            self.end()
            return False
        elif fault == "disconnect":
            self.end()
            return False
        elif fault == "half_open":
            self._deaf = True
            return True
        elif fault in ("busy", "exception") and request:
            code = 6 if fault == "busy" else 1 + dice.below(4)
            self._host.sendall(frame[:4] + struct.pack(">HBBB", 3, frame[6], frame[7] | 0x80, code))
            return True
        elif fault == "second_master" and request:
            self._second_master()
        if fault != "drop":
            sink.sendall(frame)
        return True

    def _second_master(self) -> None:
        """Another host, on a connection of its own, tries a command without the lease."""
        with suppress(OSError), socket.create_connection(self._proxy._target, timeout=1.0) as other:
            address = self._proxy.dice.below(0x0B00)
            other.sendall(struct.pack(">HHHBBHHBHH", 1, 0, 11, 1, 16, address, 2, 4, 0xDEAD, 0xBEEF))
            other.settimeout(0.2)
            other.recv(64)

    def end(self) -> None:
        """Close both sides; safe twice."""
        self.ended = True
        for one in (self._host, self._device):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()


class CanSpoiler:
    """Spoils the frames of a `drivers.device.hub.CanHub`: give it as ``spoil``."""

    def __init__(self, plan: FaultPlan, node_id: int = 5) -> None:
        self.dice = Dice(plan)
        self._node_id = node_id
        self._older: dict[int, Frame] = {}
        self._off_until = 0.0

    def __call__(self, frame: Frame) -> list[tuple[float, Frame]]:
        """What reaches the others instead, each with a delay, s."""
        if time.monotonic() < self._off_until:
            return []
        fault = self.dice.fault()
        older = self._older.get(frame.identifier, frame)
        if self.dice.on and self.dice.below(8) == 0:
            self._older[frame.identifier] = frame
        here = (0.0, frame)
        if fault == "drop":
            return []
        if fault == "delay":
            return [(self.dice.delay_s(), frame)]
        if fault == "duplicate":
            return [here, here]
        if fault == "truncate":
            return [(0.0, Frame(frame.identifier, frame.data[: self.dice.below(max(len(frame.data), 1))]))]
        if fault == "corrupt":
            return [(0.0, Frame(frame.identifier, self.dice.flipped(frame.data)))]
        if fault == "stale":
            return [here, (0.0, older)]
        if fault == "disconnect":
            self._off_until = time.monotonic() + BUS_OFF_S
            return []
        extra = {
            "error_frame": Frame(0x08, b"\0" * 8, error=True),
            "exception": Frame(0x580 + self._node_id, struct.pack("<BHBL", 0x80, 0x2101, 0, 0x08000000)),
            "second_master": Frame(0x600 + self._node_id, struct.pack("<BHBxxxx", 0x40, 0x2101, 0)),
        }.get(fault)
        return [here] if extra is None else [(0.0, extra), here]
