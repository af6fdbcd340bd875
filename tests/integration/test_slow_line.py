"""Lines that a raw record keeps busy for long: serial of 115200 baud, for longer than a lease lasts, and CAN."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from drivers.controller import Tone
from drivers.device.hub import CanHub
from drivers.device.machine import RigDevice
from drivers.device.modbus import RtuServer
from drivers.device.serve import (
    CanOptions,
    ModbusOptions,
    RtuOptions,
    Served,
    serve_canopen,
    serve_modbus,
    serve_modbus_rtu,
)
from drivers.errors import CancelledError, ControllerError
from drivers.url import connect
from sim.reference import reference_rig

RECORD = Tone(axis=0, amplitude_a=0.0, periods=1, samples=400, blocks=1, raw=True)
"""19 kB, which take two seconds."""
TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=1)
LEASE_S = 1.0


@pytest.fixture
def line() -> Iterator[Served]:
    served = serve_modbus_rtu(RigDevice(reference_rig(), seed=1), RtuOptions(throttle=True))
    yield served
    served.close()


def test_a_line_on_which_the_watchdog_would_end_every_tone_is_refused_when_it_is_opened() -> None:
    for baud, watchdog_s in ((4800, 0.2), (9600, 0.1)):
        device = RigDevice(reference_rig(), seed=1, watchdog_s=watchdog_s)
        served = serve_modbus_rtu(device, RtuOptions(throttle=True, baud=baud))
        with pytest.raises(ControllerError, match=r"338 ms, and 200 ms|169 ms, and 100 ms") as refused:
            connect(served.url)
        assert "set a baud at least 1.8 times as high there and in the URL" in str(refused.value)
        served.close()


def test_a_slow_line_to_a_patient_watchdog_plays_tones() -> None:
    device = RigDevice(reference_rig(), seed=1, watchdog_s=0.5, real_time=True)
    served = serve_modbus_rtu(device, RtuOptions(throttle=True, baud=4800))
    controller = connect(served.url)
    try:
        with controller.lease("slow line"):
            assert controller.measure(replace(TONE, blocks=10)).tone.blocks == 10
    finally:
        controller.close()
        served.close()


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """Requests for blocks of data that the device has answered."""
    asked: list[bytes] = []
    answer = RtuServer._answer

    def noted(server: RtuServer, frame: bytes) -> bytes:
        if frame[1] == 4:  # read input registers
            asked.append(frame)
        return answer(server, frame)

    monkeypatch.setattr(RtuServer, "_answer", noted)
    return asked


def test_a_raw_record_that_takes_longer_than_the_lease_does_not_end_it(line: Served, blocks: list[bytes]) -> None:
    controller = connect(line.url)
    try:
        with controller.lease("slow line", seconds=LEASE_S):
            point = controller.measure(RECORD)
            assert point.records is not None
            assert len(point.records["y"]) == RECORD.samples
            assert controller.status().lease_holder == "slow line"
            assert controller.measure(TONE).tone == TONE
    finally:
        controller.close()
    bits = 10 * 255 * len(blocks)
    assert bits / 115200 > LEASE_S, "the line is not busy for long enough to tell"


def test_how_long_a_raw_record_takes_is_known_beforehand(line: Served) -> None:
    fast = serve_modbus(line.device, ModbusOptions(port=0))
    waits = []
    for served in (line, fast):
        controller = connect(served.url)
        waits.append(controller.capabilities().record_wait_s(30_000))
        controller.close()
    fast.close()
    on_the_line = 48 * 30_000 * 10 / 115200  # its bytes alone
    assert on_the_line < waits[0] < 1.5 * on_the_line
    assert waits[1] == 0.0, "nobody waits for a network"


def test_how_long_a_raw_record_takes_over_can_is_known_beforehand() -> None:
    hub = CanHub(bitrate=500_000)
    served = serve_canopen(RigDevice(reference_rig(), seed=1), CanOptions(bus=f"socketcand/127.0.0.1:{hub.port}/can0"))
    controller = connect(served.url.replace("bitrate=1000000", "bitrate=500000"))
    try:
        told = controller.capabilities().record_wait_s(RECORD.samples)
        with controller.lease("slow line"):
            before = hub.bits
            controller.measure(RECORD)
            on_the_line = (hub.bits - before) / 500_000
        assert 0.8 * on_the_line < told < 1.2 * on_the_line
        unknown = connect(served.url.partition("&")[0])
        assert unknown.capabilities().record_wait_s(RECORD.samples) == 0.0, "nobody knows the line's rate"
        unknown.close()
    finally:
        controller.close()
        served.close()
        hub.close()


def test_a_stop_goes_between_two_blocks_of_a_raw_record_and_ends_it(line: Served, blocks: list[bytes]) -> None:
    controller = connect(line.url)

    def stop() -> int:
        until = time.monotonic() + 60
        while len(blocks) < 10 and time.monotonic() < until:
            time.sleep(0.001)
        controller.stop()
        return len(blocks)

    try:
        with ThreadPoolExecutor() as pool, controller.lease("slow line"):
            heard = pool.submit(stop)
            with pytest.raises(CancelledError, match="the raw record was on its way; the excitation is off"):
                controller.measure(RECORD)
            assert heard.result() <= len(blocks) < 60, "it had to wait for the record of 80 blocks"
            assert any(event.text == "stop" for event in line.device.events())
            assert controller.measure(TONE).tone == TONE
    finally:
        controller.close()


def test_a_stop_ends_a_raw_record_in_the_middle_of_its_transfer_over_can() -> None:
    """One block transfer, twelve seconds of a line of 500 kbit/s; the line serves others at once."""
    record = replace(RECORD, samples=8000)
    whole = 48 * record.samples / 7  # frames
    hub = CanHub(bitrate=500_000)
    served = serve_canopen(RigDevice(reference_rig(), seed=1), CanOptions(bus=f"socketcand/127.0.0.1:{hub.port}/can0"))
    controller = connect(served.url)

    def stop() -> None:
        until = time.monotonic() + 60
        while hub.frames < 0.1 * whole and time.monotonic() < until:
            time.sleep(0.001)
        controller.stop()

    stopper = threading.Thread(target=stop, daemon=True)
    try:
        with controller.lease("slow line"):
            stopper.start()
            with pytest.raises(CancelledError, match="the raw record was on its way; the excitation is off"):
                controller.measure(record)
            stopper.join()
            assert hub.frames < 0.4 * whole, "it had to wait for the record"
            asked = hub.frames
            assert controller.measure(TONE).tone == TONE
            assert hub.frames - asked < 0.1 * whole, "the record still came"
    finally:
        controller.close()
        served.close()
        hub.close()
