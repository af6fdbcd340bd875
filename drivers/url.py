"""The one factory of controllers: a URL says which driver, and where."""

from __future__ import annotations

import ssl
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from urllib.parse import SplitResult

from drivers.address import PORTS, Query, understood
from drivers.controller import Controller
from drivers.errors import ControllerError
from drivers.link import LinkFactory
from drivers.modbus.framing import framing
from drivers.modbus.map import DEFAULT_MAP, RegisterMap, read_map
from drivers.remote import RemoteController
from drivers.transcript import RecordingLinks, replay_links
from sim.errors import reason
from sim.rig import Rig


def _simulated(url: SplitResult, query: Query, rig: Rig | None) -> Controller:
    from drivers.simulated.driver import SimulatedController  # its compiler takes half a second that no bus needs

    if rig is None:
        from sim.reference import reference_rig

        rig = _of_datasheet(Path(query["rig"])) if "rig" in query else reference_rig()
    return SimulatedController(rig, seed=int(query.get("seed", 0)))


def _of_datasheet(path: Path) -> Rig:
    """The rig that a datasheet describes, with the noise that a rig has: without it nothing can be told from none."""
    from sim import rig_file, twin
    from sim.reference import reference_noise

    sheet = rig_file.read(path)
    noise = reference_noise(sheet.displacement_limit_m, sheet.current_limit_a)
    return replace(twin.rig_from_datasheet(sheet), noise=noise)


def _modbus(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.modbus.driver import tcp_links

    return tcp_links(url.hostname or "", url.port or PORTS[url.scheme], int(query.get("unit", 1)), _map(query))


def _modbus_tls(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.modbus.driver import tls_links

    try:
        context = ssl.create_default_context(cafile=query.get("ca"))
        if "cert" in query:
            context.load_cert_chain(query["cert"], query.get("key"))
    except (OSError, ssl.SSLError) as error:
        files = ", ".join(query[name] for name in ("ca", "cert", "key") if name in query)
        raise ControllerError(f"{url.geturl()}: cannot use the certificates {files}: {reason(error)}") from error
    return tls_links(url.hostname or "", url.port or PORTS[url.scheme], context, int(query.get("unit", 1)), _map(query))


def _modbus_rtu(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.modbus.driver import rtu_links

    baud, unit = int(query.get("baud", 115200)), int(query.get("unit", 1))
    return rtu_links(url.path, baud, unit, _map(query), framing(query.get("parity", "")))


def _canopen(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.canopen import map as canopen_map
    from drivers.canopen.driver import CanopenLinks

    objects = canopen_map.read_map(Path(query["map"])) if "map" in query else canopen_map.DEFAULT_MAP
    bitrate = int(query["bitrate"]) if "bitrate" in query else None
    return CanopenLinks(url.netloc + url.path, int(query["node"]), bitrate, objects)


def _replay(url: SplitResult, query: Query) -> LinkFactory:
    return replay_links(Path(url.netloc + url.path))


_BUSES: dict[str, Callable[[SplitResult, Query], LinkFactory]] = {
    "modbus": _modbus,
    "modbuss": _modbus_tls,
    "modbus+rtu": _modbus_rtu,
    "canopen": _canopen,
    "replay": _replay,
}


def connect(url: str, rig: Rig | None = None) -> Controller:
    """Controller at a URL.

    ============================================================ ==============================================
    ``simulated://?rig=rig.toml&seed=1``                         simulated rig in this process: the argument
                                                                 ``rig``, or the datasheet's, or the reference
    ``modbus://host:502?unit=1``                                 Modbus TCP
    ``modbuss://host:802?ca=ca.pem&cert=host.pem&key=host.key``  Modbus TCP in TLS
    ``modbus+rtu:///dev/ttyUSB0?baud=115200&parity=E``           Modbus RTU; parity E or O with one stop bit, N with
                                                                 two; without it none, and one
    ``canopen://socketcan/can0?node=5&bitrate=1000000``          CANopen; also ``socketcand/host:port/can0``,
                                                                 ``udp_multicast/239.74.163.2:43113`` and
                                                                 ``virtual/name`` (one process)
    ``replay:///path/session.jsonl``                             a recorded session
    ============================================================ ==============================================

    Modbus and CANopen take ``map=map.toml``, a rig's own registers or objects; every bus takes
    ``transcript=session.jsonl``, which records the session. A CAN interface has its bit rate already: ``bitrate`` says
    which it is, so that how long a raw record takes is known.

    Raises
    ------
    AddressError
        An unknown scheme or option, or a number out of its range; names the ones there are.
    BusError
        Nothing answers there.
    """
    parts, query = understood(url)
    if parts.scheme not in _BUSES:
        return _simulated(parts, query, rig)
    links = _BUSES[parts.scheme](parts, query)
    if "transcript" in query:
        links = RecordingLinks(links, Path(query["transcript"]))
    return RemoteController(links)


def _map(query: Query) -> RegisterMap:
    return read_map(Path(query["map"])) if "map" in query else DEFAULT_MAP
