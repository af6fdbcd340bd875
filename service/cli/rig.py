"""``ambit rig``: a simulated rig as a device process, and the datasheet of the reference rig."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.device.lease import WATCHDOG_S
from service.cli.console import print_json
from service.cli.usage import finite, speed, value_of
from service.remarks import say
from sim.errors import EffectError, OptionsError
from sim.withheld import CAMPAIGN_S

if TYPE_CHECKING:
    from drivers.device.rigs import BuiltRig
    from drivers.device.serve import Served

app = typer.Typer(no_args_is_help=True, help="A simulated rig as a device process, and its datasheet.")


class Protocol(StrEnum):
    """Buses on which a rig can be served."""

    modbus = "modbus"
    modbus_tls = "modbus-tls"
    modbus_rtu = "modbus-rtu"
    canopen = "canopen"


class Parity(StrEnum):
    """Parity of a serial line."""

    even = "E"
    odd = "O"
    none = "N"


@app.command()
def datasheet(
    out: Annotated[Path | None, typer.Option(help="File to write; stdout without it.")] = None,
) -> None:
    """Write the datasheet of the reference rig: what was known before the experiment."""
    from service.output import write_text
    from sim.reference import reference_datasheet
    from sim.rig_file import to_toml

    text = to_toml(reference_datasheet())
    if out is None:
        sys.stdout.write(text)
    else:
        write_text(out, text)


@app.command()
def serve(
    protocol: Annotated[Protocol, typer.Option(help="Bus.")] = Protocol.modbus,
    rig: Annotated[Path | None, typer.Option(help="Datasheet; the reference rig without it.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 0,
    effect: Annotated[
        list[str] | None, typer.Option(help="Effect: id, id=value or id:name=value,name=value; may be repeated.")
    ] = None,
    withheld: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Draw a case of the blind trial with this seed: one effect, two, none or a law of no catalogue, on "
            "the rig of --rig, or on one that is drawn, too. No one is told but the sealed file.",
        ),
    ] = None,
    sealed: Annotated[
        Path, typer.Option(help="Sealed file of what is withheld; the datasheet of a drawn rig is written beside it.")
    ] = Path("withheld.json"),
    campaign_s: Annotated[
        float,
        typer.Option(
            help="Rig time that the campaign on a withheld case will take, for a law that sets in on the way: some "
            "400 s with --quick, 1500 s without.",
            min=1.0,
        ),
    ] = CAMPAIGN_S,
    noise: Annotated[bool, typer.Option(help="Noise of sensors and currents.")] = True,
    gravity_m_per_s2: Annotated[float | None, typer.Option(help="Gravity on the rotor.", callback=finite)] = None,
    speed_rad_s: Annotated[float | None, typer.Option(help="Speed of the rotor.", callback=speed)] = None,
    real_time: Annotated[bool, typer.Option("--real-time", help="Hold the rig to the wall clock.")] = False,
    watchdog_s: Annotated[
        float, typer.Option(help="Excitation ends, and a trip latches, when the host is silent for so long.", min=0.01)
    ] = WATCHDOG_S,
    events: Annotated[Path | None, typer.Option(help="File for the device's events, JSON lines.")] = None,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.", min=0, max=65535)] = 0,
    unit: Annotated[int, typer.Option(help="Modbus unit.", min=1, max=247)] = 1,
    own_map: Annotated[
        Path | None, typer.Option("--map", help="A rig's own map of registers or CANopen objects, TOML.")
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="modbus-tls: certificate, PEM.")] = None,
    key: Annotated[Path | None, typer.Option(help="modbus-tls: its key, PEM.")] = None,
    client_ca: Annotated[Path | None, typer.Option(help="modbus-tls: authority of the hosts' certificates.")] = None,
    device: Annotated[str, typer.Option(help="modbus-rtu: serial port; a pseudo-terminal without it.")] = "",
    baud: Annotated[int, typer.Option(help="modbus-rtu: bits per second.", min=300)] = 115200,
    parity: Annotated[
        Parity | None,
        typer.Option(help="modbus-rtu: E or O with one stop bit, N with two; none, and one, without it."),
    ] = None,
    bus: Annotated[str, typer.Option(help="canopen: bus address; a socketcand hub of its own without it.")] = "",
    node: Annotated[int, typer.Option(help="canopen: node number.", min=1, max=127)] = 5,
    pre_operational: Annotated[
        bool,
        typer.Option("--pre-operational", help="canopen: take process data only once a host has started the node."),
    ] = False,
    bitrate: Annotated[int, typer.Option(help="canopen: bits per second.", min=10_000)] = 1_000_000,
    throttle: Annotated[
        bool, typer.Option("--throttle", help="canopen, modbus-rtu: hold hub or pseudo-terminal to the bit rate.")
    ] = False,
    faults: Annotated[
        str, typer.Option(help="Faults on purpose, probability per frame: drop=0.01,corrupt=0.002, or all=0.001.")
    ] = "",
    fault_seed: Annotated[int, typer.Option(help="Seed of the faults.", min=0)] = 0,
    until_stdin_closes: Annotated[
        bool, typer.Option("--until-stdin-closes", help="End with stdin: for a program that starts the rig.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print URL, commitment and datasheet as JSON.")] = False,
) -> None:
    """Serve a simulated rig until Ctrl-C; prints the URL to connect to when it is ready."""
    from drivers.device import serve as devices
    from drivers.device.faults import FaultPlan
    from drivers.device.machine import RigDevice
    from drivers.device.rigs import RigOptions, build_rig

    options = RigOptions(
        rig, seed, tuple(effect or ()), withheld, sealed, campaign_s, noise, gravity_m_per_s2, speed_rad_s
    )
    with value_of("--faults"):
        FaultPlan.parse(faults, fault_seed)
    if protocol is Protocol.modbus_tls and (certificate is None or key is None):
        raise typer.BadParameter("needs --certificate and --key, PEM files", param_hint="--protocol modbus-tls")
    with value_of("--effect", EffectError) if effect else nullcontext(), value_of("--withheld", OptionsError):
        built = build_rig(options)
    log = devices.EventLog(events) if events else None
    machine = RigDevice(
        built.rig,
        real_time=real_time,
        watchdog_s=watchdog_s,
        on_event=log,
        simulation=built.simulation,
        identity=built.identity,
    )
    served: Served
    match protocol:
        case Protocol.modbus_rtu:
            rtu = devices.RtuOptions(
                device, baud, unit, own_map, faults, fault_seed, throttle, parity.value if parity else ""
            )
            served = devices.serve_modbus_rtu(machine, rtu)
        case Protocol.canopen:
            can = devices.CanOptions(
                bus, node, bitrate, host, port, throttle, own_map, faults, fault_seed, not pre_operational
            )
            served = devices.serve_canopen(machine, can)
        case _:
            tcp = devices.ModbusOptions(host, port, unit, own_map, certificate, key, client_ca, faults, fault_seed)
            secure = protocol is Protocol.modbus_tls
            served = (devices.serve_modbus_tls if secure else devices.serve_modbus)(machine, tcp)
    devices.run(
        served,
        ready=lambda: _announce(served, built, as_json),
        draw=_status() if sys.stderr.isatty() else None,
        until_stdin_closes=until_stdin_closes,
    )


def _announce(served: Served, built: BuiltRig, as_json: bool) -> None:
    """The URL, and what was withheld as a hash; the reader may be a program that waits for it."""
    if as_json:
        datasheet = None if built.datasheet is None else str(built.datasheet)
        print_json({"url": served.url, "commitment": built.commitment or None, "datasheet": datasheet})
    else:
        print(served.url)
        if built.commitment:
            print(f"withheld: {built.commitment}\ndatasheet: {built.datasheet}")
    sys.stdout.flush()
    if sys.stderr.isatty():
        say("serving; Ctrl-C ends it")


def _status() -> Callable[[str], None]:
    """Draws the device's status over the line before, on a terminal."""

    def draw(line: str) -> None:
        sys.stderr.write(f"\r\x1b[2K{line[:200]}")
        sys.stderr.flush()

    return draw
