"""The device process: a simulated rig on a bus. One plain function for each protocol, and `run`, which waits.

>>> from sim.reference import reference_rig
>>> from drivers.device.machine import RigDevice
>>> served = serve_modbus(RigDevice(reference_rig()), ModbusOptions(port=0))
>>> served.url.startswith("modbus://127.0.0.1:")
True
>>> served.close()
"""

from __future__ import annotations

import json
import os
import signal
import ssl
import sys
import threading
import tty
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from drivers.controller import State
from drivers.device.faults import CanSpoiler, FaultPlan, ModbusSpoiler
from drivers.device.front import DeviceFront
from drivers.device.machine import Event, RigDevice
from drivers.device.modbus import RtuServer, TcpServer
from drivers.errors import ControllerError
from drivers.modbus.framing import framing
from drivers.modbus.map import DEFAULT_MAP, RegisterMap, read_map
from sim.errors import reason

SWITCH_INTERVAL_S = 0.0005
"""How long a thread of the device process may keep the others waiting: the bus answers while the rig is computed."""


@dataclass(frozen=True)
class ModbusOptions:
    """Modbus TCP, and TLS when certificates are given."""

    host: str = "127.0.0.1"
    port: int = 5020
    """0 takes a free one."""
    unit: int = 1
    map: Path | None = None
    """A rig's own register map."""
    certificate: Path | None = None
    key: Path | None = None
    client_ca: Path | None = None
    """Hosts must show a certificate of this authority."""
    faults: str = ""
    """Faults on purpose, ``drop=0.01,corrupt=0.01`` or ``all=0.001`` per frame."""
    fault_seed: int = 0


@dataclass(frozen=True)
class RtuOptions:
    """Modbus RTU."""

    device: str = ""
    """Serial port; empty makes a pseudo-terminal, whose name is in the URL."""
    baud: int = 115200
    unit: int = 1
    map: Path | None = None
    faults: str = ""
    """As for Modbus TCP."""
    fault_seed: int = 0
    throttle: bool = False
    """Hold a pseudo-terminal back to the bit rate, as a serial port is by itself."""
    parity: str = ""
    """Of a serial port: E, O or N, as in the URL; empty for none, with one stop bit."""


@dataclass(frozen=True)
class CanOptions:
    """CANopen. ``bus`` is an address of `drivers.canopen.bus`; empty starts a hub that speaks socketcand."""

    bus: str = ""
    node: int = 5
    bitrate: int = 1_000_000
    hub_host: str = "127.0.0.1"
    hub_port: int = 0
    throttle: bool = False
    """Hold the hub's frames back to the bit rate."""
    map: Path | None = None
    """A rig's own objects."""
    faults: str = ""
    """Faults on purpose, as for Modbus; on a hub of its own only."""
    fault_seed: int = 0
    self_starting: bool = True
    """Take process data from the beginning; otherwise once a host has started the node, as CiA 301 has it."""


@dataclass(frozen=True)
class Served:
    """A device on a bus."""

    url: str
    """For `drivers.url.connect`."""
    device: RigDevice
    shut: Callable[[], None]

    def close(self) -> None:
        """Excitation off, then off the bus."""
        self.device.close()
        self.shut()


def _registers(path: Path | None) -> RegisterMap:
    return DEFAULT_MAP if path is None else read_map(path)


def _spoiler(faults: str, seed: int) -> ModbusSpoiler | None:
    return ModbusSpoiler(FaultPlan.parse(faults, seed)) if faults else None


def serve_modbus(device: RigDevice, options: ModbusOptions) -> Served:
    """The device on Modbus TCP.

    Raises
    ------
    ControllerError
        The address cannot be listened on, or the map is wrong.
    """
    return _serve_tcp(device, options, "modbus")


def serve_modbus_tls(device: RigDevice, options: ModbusOptions) -> Served:
    """The device on Modbus TCP in TLS; hosts need a certificate of ``client_ca`` when that is given."""
    if options.certificate is None:
        raise ControllerError("Modbus in TLS needs a certificate and its key (PEM files)")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(options.certificate, options.key)
        if options.client_ca is not None:
            context.load_verify_locations(options.client_ca)
            context.verify_mode = ssl.CERT_REQUIRED
    except (OSError, ssl.SSLError) as error:
        raise ControllerError(f"cannot use the certificates: {reason(error)}") from error
    return _serve_tcp(device, options, "modbuss", context)


def _serve_tcp(device: RigDevice, options: ModbusOptions, scheme: str, context: ssl.SSLContext | None = None) -> Served:
    server = TcpServer(
        DeviceFront(device, "big"),
        options.host,
        options.port,
        options.unit,
        _registers(options.map),
        context,
        _spoiler(options.faults, options.fault_seed),
    )
    return Served(f"{scheme}://{options.host}:{server.port}?unit={options.unit}", device, server.close)


def serve_modbus_rtu(device: RigDevice, options: RtuOptions) -> Served:
    """The device on Modbus RTU: a serial port, or a new pseudo-terminal."""
    import serial

    front = DeviceFront(device, "big")
    registers, spoiler = _registers(options.map), _spoiler(options.faults, options.fault_seed)
    frames = framing(options.parity)
    if options.parity and not options.device:
        raise ControllerError("a pseudo-terminal has no parity: give the serial port, or leave the parity out")
    if options.device:
        try:
            port = serial.Serial(
                options.device, options.baud, parity=frames.parity, stopbits=frames.stop_bits, timeout=0
            )
        except (OSError, serial.SerialException, ValueError) as error:
            raise ControllerError(f"cannot open the serial port {options.device}: {reason(error)}") from error
        server = RtuServer(front, port.fileno(), options.unit, registers, spoiler)
        name, close_port = options.device, port.close
    else:
        master, slave = os.openpty()
        tty.setraw(slave)
        pace = options.baud / frames.bits if options.throttle else None
        server = RtuServer(front, master, options.unit, registers, spoiler, pace)
        name = os.ttyname(slave)

        def close_port() -> None:
            os.close(master)
            os.close(slave)

    def shut() -> None:
        server.close()
        close_port()

    parity = f"&parity={options.parity}" if options.parity else ""
    return Served(f"modbus+rtu://{name}?baud={options.baud}&unit={options.unit}{parity}", device, shut)


def serve_canopen(device: RigDevice, options: CanOptions) -> Served:
    """The device as a CANopen node, on a bus that exists or on a hub of its own."""
    from drivers.canopen import map as canopen_map
    from drivers.device.canopen import CanopenNode
    from drivers.device.hub import CanHub

    if not 1 <= options.node <= 127:
        raise ControllerError(f"a CANopen node has a number from 1 to 127, not {options.node}")
    objects = canopen_map.DEFAULT_MAP if options.map is None else canopen_map.read_map(options.map)
    hub = None
    address = options.bus
    if address and options.faults:
        raise ControllerError("faults on purpose need a hub of the device's own: give no CAN bus")
    if not address:
        spoil = (
            CanSpoiler(FaultPlan.parse(options.faults, options.fault_seed), options.node) if options.faults else None
        )
        hub = CanHub(options.hub_host, options.hub_port, options.bitrate if options.throttle else None, spoil)
        address = f"socketcand/{hub.host}:{hub.port}/can0"
    try:
        node = CanopenNode(DeviceFront(device, "little"), address, options.node, objects, options.self_starting)
    except ControllerError:
        if hub is not None:
            hub.close()
        raise

    def shut() -> None:
        node.close()
        if hub is not None:
            hub.close()

    return Served(f"canopen://{address}?node={options.node}&bitrate={options.bitrate}", device, shut)


class EventLog:
    """Writes a device's events to a file as JSON lines, at once, so that they outlive the process."""

    def __init__(self, path: Path) -> None:
        try:
            self._file = path.open("a", encoding="utf-8")
        except OSError as error:
            raise ControllerError(f"cannot write the events to {path}: {reason(error)}") from error
        self._lock = threading.Lock()

    def __call__(self, event: Event) -> None:
        """Write one event."""
        line = json.dumps({"number": event.number, "monotonic_s": event.monotonic_s, "text": event.text})
        with self._lock:
            if not self._file.closed:
                self._file.write(line + "\n")
                self._file.flush()

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._file.close()


def status_line(device: RigDevice) -> str:
    """One line that shows what the device does now."""
    s = device.status()
    y = " ".join(f"{a} {v * 1e6:+7.2f}" for a, v in zip(device.rig.axes, s.displacement_m, strict=True))
    text = f"{s.state.name:<10} y/um {y}  r {s.excitation_a:.3f} A  rig time {device.rig_time_s:9.1f} s"
    if s.lease_holder:
        text += f"  leased to {s.lease_holder} ({s.lease_seconds_left:.0f} s)"
    return text + (f"  TRIP {s.trip_message}" if s.state is State.TRIPPED else "")


def run(
    served: Served,
    ready: Callable[[], None] | None = None,
    draw: Callable[[str], None] | None = None,
    until_stdin_closes: bool = False,
    period_s: float = 0.2,
) -> None:
    """Serve until SIGINT or SIGTERM, then switch the excitation off and leave the bus.

    Parameters
    ----------
    ready
        Called once a signal would end the device in good order.
    draw
        Gets the status line whenever it has changed.
    until_stdin_closes
        End, too, when stdin does: whoever started the device holds its other end, and cannot leave it behind.
    """
    end = threading.Event()
    sys.setswitchinterval(SWITCH_INTERVAL_S)

    def ask(signum: int, frame: FrameType | None) -> None:
        end.set()

    before = {s: signal.signal(s, ask) for s in (signal.SIGINT, signal.SIGTERM)}
    shown = ""
    try:
        if until_stdin_closes:
            threading.Thread(target=_wait_for_end_of_input, args=(end,), name="stdin", daemon=True).start()
        if ready is not None:
            ready()
        while not end.wait(period_s):
            if draw is not None and (line := status_line(served.device)) != shown:
                draw(line)
                shown = line
    finally:
        served.close()
        for number, handler in before.items():
            signal.signal(number, handler)


def _wait_for_end_of_input(end: threading.Event) -> None:
    with suppress(OSError):
        while os.read(0, 4096):
            pass
    end.set()
