"""Faults on purpose, seeded: a spoiler for the Modbus servers, and one for the CAN hub.

==============  ==============================  ==========================================================
fault           Modbus                          CAN
==============  ==============================  ==========================================================
drop            the frame is lost               the frame is lost
delay           it comes late                   it comes late, after later ones
duplicate       it comes twice                  it comes twice
truncate        part of it, then the end of     its last bytes are missing
                the connection (RTU: silence)
corrupt         one bit is flipped              one bit is flipped
stale           an older answer comes instead   an older frame of the same identifier comes again
busy            "device busy", not asked        -
exception       a random exception, not asked   an SDO abort comes in
half_open       nothing passes any more, and    -
                the connection stays
disconnect      the connection ends (RTU:       bus-off: nothing passes for a while
                nothing passes for a while)
error_frame     -                               an error frame comes before it
second_master   another host asks in between    another master's SDO request comes in between
==============  ==============================  ==========================================================
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
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


@dataclass(frozen=True)
class Wire:
    """How one transport wraps a Modbus PDU, for `SpoiltConversation`."""

    function_at: int
    """Place of the function code in a frame."""
    covered_from: int
    """First byte that a flipped bit may hit: before it a transport would lose its step, not a value."""
    reply: Callable[[bytes, bytes], bytes]
    """(request, PDU) -> answer's frame."""
    connected: bool
    """Whether there are connections that can end; a serial line falls silent instead."""


class ModbusSpoiler:
    """Spoils the frames of a Modbus server: give it as ``spoiler``. All connections share its dice."""

    def __init__(self, plan: FaultPlan) -> None:
        self.dice = Dice(plan)
        self._answers: dict[int, bytes] = {}
        self._lock = threading.Lock()

    def older_answer(self, function: int, pdu: bytes) -> bytes:
        """An earlier answer to the same function, this one if there is none; and perhaps remember this one."""
        remember = self.dice.below(4) == 0
        with self._lock:
            older = self._answers.get(function, pdu)
            if remember:
                self._answers[function] = pdu
        return older


class SpoiltConversation:
    """One connection's requests and answers, through the faults.

    Parameters
    ----------
    answer
        The device's frame to a request's, empty for none.
    send
        To the host, a frame or what is left of it.
    other_host
        The device's PDU to another host's.
    """

    def __init__(
        self,
        spoiler: ModbusSpoiler,
        wire: Wire,
        answer: Callable[[bytes], bytes],
        send: Callable[[bytes], None],
        other_host: Callable[[bytes], bytes],
    ) -> None:
        self._spoiler, self._dice, self._wire = spoiler, spoiler.dice, wire
        self._answer, self._send, self._other_host = answer, send, other_host
        self._deaf_until = 0.0

    def take(self, request: bytes) -> bool:
        """Answer a request's frame, or not quite; False when the connection ends."""
        if time.monotonic() < self._deaf_until:
            return True
        dice, fault = self._dice, self._dice.fault()
        if (goes_on := self._gone(fault)) is not None:
            return goes_on
        request = self._worn(fault, request)
        match fault:
            case "truncate":
                return not self._wire.connected  # a request that was cut short is no request
            case "busy" | "exception":
                code = 6 if fault == "busy" else 1 + dice.below(4)
                function = request[self._wire.function_at]
                self._send(self._wire.reply(request, bytes([function | 0x80, code])))
                return True
            case "second_master":
                self._second_master(request)
        for _ in range(2 if fault == "duplicate" else 1):
            frame = self._answer(request)
            if frame and not self._pass_on(request, frame):
                return False
        return True

    def _pass_on(self, request: bytes, frame: bytes) -> bool:
        """An answer on its way to the host; False when the connection ends."""
        dice, fault = self._dice, self._dice.fault()
        function = frame[self._wire.function_at]
        pdu = frame[self._wire.function_at : None if self._wire.connected else -2]
        older = self._spoiler.older_answer(function, pdu)
        if (goes_on := self._gone(fault)) is not None:
            return goes_on
        frame = self._worn(fault, frame)
        match fault:
            case "duplicate":
                frame = frame + frame
            case "truncate":
                self._send(frame[: 1 + dice.below(len(frame) - 1)])
                return not self._wire.connected
            case "stale":
                frame = self._wire.reply(request, older)
        self._send(frame)
        return True

    def _gone(self, fault: str) -> bool | None:
        """Whether the connection goes on after a fault that takes a frame away, on either way; None for another."""
        match fault:
            case "drop":
                return True
            case "disconnect":
                return self._lost()
            case "half_open":
                return self._deaf()
        return None

    def _worn(self, fault: str, frame: bytes) -> bytes:
        """A frame that came late or with flipped bits, on either way."""
        if fault == "delay":
            time.sleep(self._dice.delay_s())
        return self._dice.flipped(frame, self._wire.covered_from) if fault == "corrupt" else frame

    def _deaf(self) -> bool:
        """Nothing is heard any more; on a serial line, for a while."""
        self._deaf_until = math.inf if self._wire.connected else time.monotonic() + BUS_OFF_S
        return True

    def _lost(self) -> bool:
        """The end of the connection; a serial line has none."""
        return self._deaf() and not self._wire.connected

    def _second_master(self, request: bytes) -> None:
        """Another host tries a command without the lease; on a serial line this host hears the answer."""
        command = struct.pack(">BHHBHH", 16, self._dice.below(0x0B00), 2, 4, 0xDEAD, 0xBEEF)
        answer = self._other_host(command)
        if not self._wire.connected:
            self._send(self._wire.reply(request, answer))


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
