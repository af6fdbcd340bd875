"""Raw records: Modbus TCP beside a bare socket, SDO block beside the line's limit, each server in its own process."""

from __future__ import annotations

import os
import socket
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.controller import Controller, Tone
from drivers.device.front import DeviceFront
from drivers.device.hub import CanHub
from drivers.device.machine import RigDevice
from drivers.link import Link
from drivers.remote import RemoteController
from drivers.url import connect
from sim.reference import reference_rig

RECORD_BYTES = 120_000
BLOCK_REGISTERS = 125
TONE = Tone(axis=0, amplitude_a=0.01, periods=10, samples=RECORD_BYTES // 48, blocks=1, raw=True)

BARE_SERVER = """
import socket
listener = socket.create_server(("127.0.0.1", 0))
print(listener.getsockname()[1], flush=True)
connection, _ = listener.accept()
connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
answer = bytes(259)
while True:
    left = 12
    while left:
        chunk = connection.recv(left)
        if not chunk:
            raise SystemExit
        left -= len(chunk)
    connection.sendall(answer)
"""


@contextmanager
def _process(*arguments: str) -> Iterator[str]:
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def _bare(repetitions: int) -> float:
    """Bytes per second of a client and a server that only move frames of a block's size, one at a time."""
    with _process("-c", BARE_SERVER) as port, socket.create_connection(("127.0.0.1", int(port))) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        request = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, BLOCK_REGISTERS)
        rates = []
        for _ in range(repetitions):
            began = time.perf_counter()
            for _ in range(RECORD_BYTES // (2 * BLOCK_REGISTERS)):
                connection.sendall(request)
                left = 259
                while left:
                    left -= len(connection.recv(left))
            rates.append(RECORD_BYTES / (time.perf_counter() - began))
    return statistics.median(rates)


def _link(controller: Controller) -> Link:
    assert isinstance(controller, RemoteController)
    return controller._dialogue.link


def _driver(repetitions: int) -> float:
    """Bytes per second of our driver on our device process, CRC checked."""
    with _process("-m", "drivers.device", "--protocol", "modbus") as url:
        controller = connect(url)
        with controller.lease("benchmark"):
            sequence = controller.measure(TONE).sequence
        link = _link(controller)  # the transfer alone, without the tone
        rates = []
        for _ in range(repetitions):
            began = time.perf_counter()
            raw = link.raw_record(sequence, RECORD_BYTES)
            rates.append(len(raw) / (time.perf_counter() - began))
        controller.close()
    return statistics.median(rates)


def modbus(rounds: int = 5, repetitions: int = 5) -> tuple[float, float]:
    """Bytes per second of the driver and of bare sockets, taken in turns in the same run.

    Both pairs of processes have one core: where the scheduler puts them would else decide, by a factor of two.
    """
    with _one_core():
        pairs = [(_driver(repetitions), _bare(repetitions)) for _ in range(rounds)]
    return statistics.median(d for d, _ in pairs), statistics.median(b for _, b in pairs)


@contextmanager
def _one_core() -> Iterator[None]:
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def sdo_block(bitrate: int = 1_000_000) -> tuple[float, float, float]:
    """Bytes per second of a raw record by SDO block, its limit on that line, and the line's own rate, bit/s."""
    with _process("-m", "drivers.device", "--protocol", "canopen", "--throttle", "--bitrate", str(bitrate)) as url:
        controller = connect(url)
        with controller.lease("benchmark"):
            sequence = controller.measure(TONE).sequence
        link = _link(controller)
        rates = []
        for _ in range(3):
            began = time.perf_counter()
            raw = link.raw_record(sequence, RECORD_BYTES)
            rates.append(len(raw) / (time.perf_counter() - began))
        controller.close()
    return statistics.median(rates), sdo_block_limit(bitrate), float(bitrate)


def sdo_block_limit(bitrate: int) -> float:
    """Bytes per second of SDO block upload on a line that is never idle: 127 segments of 7 bytes, one answer."""
    frame_bits = 47 + 64
    return 127 * 7 / (128 * frame_bits / bitrate)


def hub_device(bitrate: int | None = None) -> tuple[CanHub, RigDevice, str]:
    """A hub and a device on it, in this process, so that the line's bits can be counted."""
    from drivers.device.canopen import CanopenNode

    hub = CanHub(bitrate=bitrate)
    device = RigDevice(reference_rig(), 1)
    address = f"socketcand/127.0.0.1:{hub.port}/can0"
    CanopenNode(DeviceFront(device, "little"), address, 5)
    return hub, device, f"canopen://{address}?node=5"
