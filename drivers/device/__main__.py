"""``python -m drivers.device``: the device process without the service's command line around it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from drivers.device.lease import WATCHDOG_S
from drivers.device.machine import RigDevice
from drivers.device.rigs import RigOptions, build_rig
from drivers.device.serve import (
    CanOptions,
    EventLog,
    ModbusOptions,
    RtuOptions,
    Served,
    run,
    serve_canopen,
    serve_modbus,
    serve_modbus_rtu,
    serve_modbus_tls,
)
from drivers.modbus.framing import PARITIES
from sim.errors import AmbError
from sim.withheld import CAMPAIGN_S


def _parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m drivers.device", description="A simulated rig as a device on a bus.")
    p.add_argument("--protocol", choices=("modbus", "modbus-tls", "modbus-rtu", "canopen"), default="modbus")
    p.add_argument("--rig", type=Path, help="datasheet; the reference rig without it")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--effect", action="append", default=[], help="id, id=value or id:name=value,name=value")
    p.add_argument("--real-time", action="store_true", help="hold the rig to the wall clock")
    p.add_argument("--watchdog-s", type=float, default=WATCHDOG_S)
    p.add_argument("--events", type=Path, help="file for the device's events, JSON lines")
    p.add_argument("--host", default="127.0.0.1")
    p.add_argument("--port", type=int, default=0)
    p.add_argument("--unit", type=int, default=1)
    p.add_argument("--map", type=Path)
    p.add_argument("--certificate", type=Path)
    p.add_argument("--key", type=Path)
    p.add_argument("--client-ca", type=Path)
    p.add_argument("--device", default="", help="serial port of modbus-rtu; a pseudo-terminal without it")
    p.add_argument("--baud", type=int, default=115200)
    p.add_argument("--parity", choices=PARITIES, default="", help="of modbus-rtu; 8N1 without it")
    p.add_argument("--bus", default="", help="CAN bus of canopen; a socketcand hub of its own without it")
    p.add_argument("--node", type=int, default=5)
    p.add_argument("--pre-operational", action="store_true", help="of canopen: wait for NMT start")
    p.add_argument("--bitrate", type=int, default=1_000_000)
    p.add_argument("--throttle", action="store_true", help="hold hub or pseudo-terminal to the bit rate")
    p.add_argument("--withheld", type=int, help="seed of a case that only the sealed file tells")
    p.add_argument("--sealed", type=Path, default=Path("withheld.json"))
    p.add_argument("--campaign-s", type=float, default=CAMPAIGN_S, help="rig time that a campaign on it will take")
    p.add_argument("--faults", default="", help="drop=0.01,corrupt=0.01 or all=0.001, per frame")
    p.add_argument("--fault-seed", type=int, default=0)
    return p


def _serve(device: RigDevice, a: argparse.Namespace) -> Served:
    if a.protocol == "modbus-rtu":
        rtu = RtuOptions(a.device, a.baud, a.unit, a.map, a.faults, a.fault_seed, a.throttle, a.parity)
        return serve_modbus_rtu(device, rtu)
    if a.protocol == "canopen":
        return serve_canopen(
            device,
            CanOptions(
                a.bus,
                a.node,
                a.bitrate,
                a.host,
                a.port,
                a.throttle,
                a.map,
                a.faults,
                a.fault_seed,
                not a.pre_operational,
            ),
        )
    options = ModbusOptions(a.host, a.port, a.unit, a.map, a.certificate, a.key, a.client_ca, a.faults, a.fault_seed)
    return serve_modbus(device, options) if a.protocol == "modbus" else serve_modbus_tls(device, options)


def main(arguments: list[str] | None = None) -> int:
    """Serve until a signal; prints the URL when ready."""
    a = _parser().parse_args(arguments)
    try:
        built = build_rig(RigOptions(a.rig, a.seed, tuple(a.effect), a.withheld, a.sealed, a.campaign_s))
        log = EventLog(a.events) if a.events else None
        device = RigDevice(
            built.rig,
            real_time=a.real_time,
            watchdog_s=a.watchdog_s,
            on_event=log,
            simulation=built.simulation,
            identity=built.identity,
        )
        served = _serve(device, a)
    except AmbError as error:
        print(error, file=sys.stderr)
        return 1

    def announce() -> None:
        print(served.url, flush=True)
        if built.commitment:
            print(f"commitment {built.commitment}", flush=True)
            print(f"datasheet {built.datasheet}", flush=True)

    run(served, announce)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
