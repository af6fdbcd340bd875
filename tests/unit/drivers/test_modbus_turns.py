"""A serial line carries one request at a time: who may ask next."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial

import pytest
from pymodbus.pdu.register_message import WriteMultipleRegistersResponse

from drivers.modbus.driver import ModbusLink
from drivers.modbus.map import DEFAULT_MAP
from drivers.modbus.turns import Turns, Urgency


def _asks(turns: Turns, urgency: Urgency, order: list[str], name: str) -> threading.Thread:
    """A thread that waits for its turn."""

    def ask() -> None:
        with turns.turn(urgency):
            order.append(name)

    return _waits(turns, ask)


def _waits(turns: Turns, ask: Callable[[], object]) -> threading.Thread:
    waiting = len(turns._waiting)
    thread = threading.Thread(target=ask)
    thread.start()
    while len(turns._waiting) == waiting:
        time.sleep(0.001)
    return thread


def test_a_stop_goes_before_a_heartbeat_and_that_before_data_and_equals_as_they_came() -> None:
    turns, order = Turns(), list[str]()
    with turns.turn(Urgency.DATA):
        threads = [
            _asks(turns, urgency, order, name)
            for urgency, name in (
                (Urgency.DATA, "status"),
                (Urgency.DATA, "record"),
                (Urgency.BEAT, "beat"),
                (Urgency.STOP, "stop"),
            )
        ]
    for thread in threads:
        thread.join()
    assert order == ["stop", "beat", "status", "record"]


def test_a_heartbeat_that_is_due_again_at_once_leaves_the_line_to_others_in_between() -> None:
    """On a slow line, or with an adapter that takes its time, a beat takes longer than the time to the next one."""
    turns, order = Turns(), list[str]()
    with turns.turn(Urgency.BEAT):
        threads = [
            _asks(turns, urgency, order, name)
            for urgency, name in (
                (Urgency.DATA, "status"),
                (Urgency.BEAT, "beat"),
                (Urgency.BEAT, "next beat"),
                (Urgency.DATA, "record"),
                (Urgency.BEAT, "last beat"),
            )
        ]
    for thread in threads:
        thread.join()
    assert order == ["status", "beat", "record", "next beat", "last beat"]


def test_who_asks_again_at_once_stands_behind_those_that_waited() -> None:
    turns, order = Turns(), list[str]()
    with turns.turn(Urgency.BEAT):
        thread = _asks(turns, Urgency.DATA, order, "record")
    with turns.turn(Urgency.DATA):
        order.append("again")
    thread.join()
    assert order == ["record", "again"]


def test_whoever_has_the_turn_may_take_it_again() -> None:
    turns, order = Turns(), list[str]()
    with turns.turn(Urgency.DATA):
        with turns.turn(Urgency.STOP):
            thread = _asks(turns, Urgency.STOP, order, "stop")
        assert order == []
    thread.join()
    assert order == ["stop"]


def test_an_interrupted_wait_keeps_nobody_from_the_line(monkeypatch: pytest.MonkeyPatch) -> None:
    turns, order = Turns(), list[str]()

    def interrupted() -> None:
        raise KeyboardInterrupt

    holds, go = threading.Event(), threading.Event()

    def hold() -> None:
        with turns.turn(Urgency.DATA):
            holds.set()
            go.wait()

    holder = threading.Thread(target=hold)
    holder.start()
    holds.wait()
    with monkeypatch.context() as patch:
        patch.setattr(turns._changed, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt), turns.turn(Urgency.STOP):
            pass
    waits = _asks(turns, Urgency.DATA, order, "record")
    go.set()
    holder.join()
    waits.join(timeout=10)
    assert order == ["record"]


class _Client:
    """A line that notes where a command is written."""

    def __init__(self) -> None:
        self.written: list[int] = []

    def connect(self) -> bool:
        return True

    def write_registers(self, address: int, registers: list[int], device_id: int) -> WriteMultipleRegistersResponse:
        self.written.append(address)
        return WriteMultipleRegistersResponse(address=address, count=len(registers))


def test_a_stop_goes_before_the_heartbeat_and_that_before_a_tone_whoever_came_first() -> None:
    turns, client = Turns(), _Client()
    data, beat, stop = (ModbusLink(lambda: client, DEFAULT_MAP, 1, turns, urgent) for urgent in (False, True, True))
    writes: list[tuple[ModbusLink, str, dict[str, float]]] = [
        (data, "acknowledge", {"token": 7}),
        (beat, "beat", {"token": 7, "count": 1}),
        (stop, "stop", {"token": 7}),
    ]
    with turns.turn(Urgency.DATA):
        threads = [_waits(turns, partial(link.write, group, values)) for link, group, values in writes]
    for thread in threads:
        thread.join()
    assert client.written == [DEFAULT_MAP.spans(group, 123)[0][0].address for group in ("stop", "beat", "acknowledge")]
