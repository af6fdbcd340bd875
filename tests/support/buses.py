"""Every driver with a simulated device of its own, for tests that run over all of them."""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import pytest

from drivers.controller import Controller
from drivers.device.machine import RigDevice
from drivers.device.serve import (
    CanOptions,
    ModbusOptions,
    RtuOptions,
    Served,
    serve_canopen,
    serve_modbus,
    serve_modbus_rtu,
    serve_modbus_tls,
)
from drivers.simulated.driver import SimulatedController
from drivers.url import connect
from sim.reference import reference_rig
from tests.support.certificates import make_authority


@dataclass(frozen=True)
class Bench:
    """A device that runs, and how to reach it."""

    device: RigDevice
    connect: Callable[[], Controller]
    """A connection to the device."""
    other: Callable[[], Controller]
    """Another host's connection; a serial line has but one host, so there it comes in by the device's other port."""
    fresh: Callable[..., AbstractContextManager[Controller]]
    """A connection to a device just started, with the seed given."""


def _bench(serve: Callable[[RigDevice], Served], more: str = "", one_host: bool = False) -> Iterator[Bench]:
    @contextmanager
    def fresh(seed: int) -> Iterator[Controller]:
        served = serve(RigDevice(reference_rig(), seed))
        controller = connect(served.url + more)
        try:
            yield controller
        finally:
            controller.close()
            served.close()

    served = serve(RigDevice(reference_rig(), seed=1))
    second = serve_modbus(served.device, ModbusOptions(port=0)) if one_host else None
    aside = second.url if second else ""
    try:
        yield Bench(
            served.device, lambda: connect(served.url + more), lambda: connect((aside or served.url) + more), fresh
        )
    finally:
        served.close()
        if second:
            second.close()


@contextmanager
def simulated(folder: Path) -> Iterator[Bench]:
    @contextmanager
    def fresh(seed: int) -> Iterator[Controller]:
        controller = connect(f"simulated://?seed={seed}")
        yield controller
        controller.close()

    device = RigDevice(reference_rig(), seed=1)
    yield Bench(device, lambda: SimulatedController(device), lambda: SimulatedController(device), fresh)
    device.close()


@contextmanager
def modbus(folder: Path) -> Iterator[Bench]:
    yield from _bench(lambda device: serve_modbus(device, ModbusOptions(port=0)))


@contextmanager
def modbus_tls(folder: Path) -> Iterator[Bench]:
    made = make_authority(folder)
    options = ModbusOptions(port=0, certificate=made.server.certificate, key=made.server.key, client_ca=made.ca)
    more = f"&ca={made.ca}&cert={made.client.certificate}&key={made.client.key}"
    yield from _bench(lambda device: serve_modbus_tls(device, options), more)


@contextmanager
def modbus_rtu(folder: Path) -> Iterator[Bench]:
    yield from _bench(lambda device: serve_modbus_rtu(device, RtuOptions()), one_host=True)


@contextmanager
def canopen_socketcand(folder: Path) -> Iterator[Bench]:
    yield from _bench(lambda device: serve_canopen(device, CanOptions()))


@contextmanager
def canopen_virtual(folder: Path) -> Iterator[Bench]:
    names = (f"virtual/{folder.name}-{k}" for k in count())
    yield from _bench(lambda device: serve_canopen(device, CanOptions(bus=next(names))))


@contextmanager
def canopen_socketcan(folder: Path) -> Iterator[Bench]:
    channel = next((name for name in sorted(os.listdir("/sys/class/net")) if name.startswith("vcan")), None)
    if channel is None:
        pytest.skip("no kernel CAN: make one with `ip link add dev vcan0 type vcan && ip link set up vcan0`")
    nodes = count(5)
    yield from _bench(
        lambda device: serve_canopen(device, CanOptions(bus=f"socketcan/{channel}", node=next(nodes) % 127 + 1))
    )


@contextmanager
def canopen_udp_multicast(folder: Path) -> Iterator[Bench]:
    pytest.importorskip("msgpack", reason="python-can's udp_multicast needs msgpack")
    ports = count(43200 + os.getpid() % 1000)
    addresses = (f"udp_multicast/239.74.163.2:{port}" for port in ports)
    yield from _bench(lambda device: serve_canopen(device, CanOptions(bus=next(addresses))))


BUSES: dict[str, Callable[[Path], AbstractContextManager[Bench]]] = {
    "simulated": simulated,
    "modbus": modbus,
    "modbus-tls": modbus_tls,
    "modbus-rtu": modbus_rtu,
    "canopen-socketcand": canopen_socketcand,
    "canopen-virtual": canopen_virtual,
    "canopen-udp_multicast": canopen_udp_multicast,
    "canopen-socketcan": canopen_socketcan,
}

PROTOCOLS = {
    "modbus": ("--protocol", "modbus"),
    "modbus-rtu": ("--protocol", "modbus-rtu"),
    "canopen": ("--protocol", "canopen"),
}
"""Arguments of the device process, for the protocols that need no certificates."""
