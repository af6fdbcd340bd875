"""Every driver with a simulated device of its own, for tests that run over all of them."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.controller import Controller
from drivers.device.machine import RigDevice
from drivers.device.serve import (
    ModbusOptions,
    RtuOptions,
    Served,
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


BUSES: dict[str, Callable[[Path], AbstractContextManager[Bench]]] = {
    "simulated": simulated,
    "modbus": modbus,
    "modbus-tls": modbus_tls,
    "modbus-rtu": modbus_rtu,
}

PROTOCOLS = {
    "modbus": ("--protocol", "modbus"),
    "modbus-rtu": ("--protocol", "modbus-rtu"),
}
"""Arguments of the device process, for the protocols that need no certificates."""
