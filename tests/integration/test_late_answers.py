"""Answers on a serial line that come late: RTU has no numbers by which an answer tells whose it is."""

import os
import select
import struct
import threading
import tty
from collections import deque
from collections.abc import Iterator
from contextlib import closing

import pytest
from pymodbus.framer.rtu import FramerRTU

from drivers import playing
from drivers.controller import Tone, TripCause
from drivers.device.front import DeviceFront
from drivers.device.machine import RigDevice
from drivers.device.modbus import RtuServer
from drivers.device.registers import RegisterSession
from drivers.errors import TripError
from drivers.modbus.map import DEFAULT_MAP
from drivers.url import connect
from sim.reference import reference_rig

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=1)


def _frame(pdu: bytes) -> bytes:
    return b"\1" + pdu + struct.pack(">H", FramerRTU.compute_CRC(b"\1" + pdu))


_READ_STATUS = _frame(struct.pack(">BHH", 3, 256, 53))


class Behind:
    """A device on a pseudo-terminal that gathers requests, and answers one for each that comes.

    Once it has fallen behind, every request is given the answer to the one before, until the line is silent.
    """

    def __init__(self) -> None:
        self.device = RigDevice(reference_rig(), seed=1)
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.url = f"modbus+rtu://{os.ttyname(self._slave)}"
        self._front = DeviceFront(self.device, "big")
        self._session = RegisterSession(self._front, DEFAULT_MAP)
        self._waiting: deque[bytes] = deque()
        self.falls_behind = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._closing.is_set():
            if not select.select([self._master], [], [], 0.05)[0]:
                self._waiting.clear()
                continue
            if self.falls_behind:
                self._waiting.append(_READ_STATUS)
                self.falls_behind = False
            self._waiting.append(os.read(self._master, 512))
            os.write(self._master, _frame(self._session.answer(self._waiting.popleft()[1:-2])))

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        self._front.close()
        self.device.close()
        os.close(self._master)
        os.close(self._slave)


@pytest.fixture
def behind() -> Iterator[Behind]:
    with closing(Behind()) as behind:
        yield behind


def test_the_answer_to_another_request_is_not_taken_for_this_ones(behind: Behind) -> None:
    """A trip that was told to be acknowledged, and was not, is taken for one of the next tone's."""
    with closing(connect(behind.url)) as controller, controller.lease("late"):
        behind.device.fault("a test")
        behind.falls_behind = True
        controller.acknowledge()
        assert behind.device.status().trip is TripCause.NONE
        assert controller.measure(TONE).tone == TONE


def test_a_tone_that_was_refused_is_not_waited_for(behind: Behind, monkeypatch: pytest.MonkeyPatch) -> None:
    """The refusal went to the next request, the tone was asked for again, and so on until it was overdue."""
    monkeypatch.setattr(playing, "OVERDUE_S", 3.0)
    with closing(connect(behind.url)) as controller, controller.lease("late"):
        behind.device.fault("a test")
        behind.falls_behind = True
        with pytest.raises(TripError, match="latched"):
            controller.measure(TONE)
        controller.acknowledge()


def test_requests_that_come_together_are_all_answered() -> None:
    """A machine that stood still finds what the host said, and said again; none of it may wait for the next request."""
    master, slave = os.openpty()
    tty.setraw(slave)
    server = RtuServer(DeviceFront(RigDevice(reference_rig(), seed=1), "big"), master)
    try:
        os.write(slave, 2 * _READ_STATUS)
        answers = b""
        while select.select([slave], [], [], 1.0)[0]:
            answers += os.read(slave, 512)
        assert len(answers) == 2 * (5 + 2 * 53)
    finally:
        server.close()
        os.close(master)
        os.close(slave)
