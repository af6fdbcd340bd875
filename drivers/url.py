"""The one factory of controllers: a URL says which driver, and where."""

from __future__ import annotations

import ssl
from collections.abc import Callable
from pathlib import Path
from urllib.parse import SplitResult, parse_qs, urlsplit

from drivers.controller import Controller
from drivers.errors import ControllerError
from drivers.link import LinkFactory
from drivers.modbus.map import DEFAULT_MAP, RegisterMap, read_map
from drivers.remote import RemoteController
from drivers.simulated.driver import SimulatedController
from drivers.transcript import RecordingLinks, replay_links
from sim.rig import Rig

Query = dict[str, str]


def _simulated(url: SplitResult, query: Query, rig: Rig | None) -> Controller:
    if rig is None:
        from sim import rig_file, twin
        from sim.reference import reference_rig

        rig = twin.rig_from_datasheet(rig_file.read(Path(query["rig"]))) if "rig" in query else reference_rig()
    return SimulatedController(rig, seed=_whole(query, "seed", 0))


def _modbus(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.modbus.driver import tcp_links

    return tcp_links(_host(url), _port(url, 502), _whole(query, "unit", 1, 0, 255), _map(query))


def _modbus_tls(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.modbus.driver import tls_links

    try:
        context = ssl.create_default_context(cafile=query.get("ca"))
        if "cert" in query:
            context.load_cert_chain(query["cert"], query.get("key"))
    except (OSError, ssl.SSLError) as error:
        raise ControllerError(f"{url.geturl()}: cannot use the certificates: {error}") from error
    return tls_links(_host(url), _port(url, 802), context, _whole(query, "unit", 1, 0, 255), _map(query))


def _modbus_rtu(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.modbus.driver import rtu_links

    if not url.path:
        raise ControllerError(f"{url.geturl()!r} names no serial port; write modbus+rtu:///dev/ttyUSB0?baud=115200")
    return rtu_links(url.path, _whole(query, "baud", 115200, 1), _whole(query, "unit", 1, 0, 255), _map(query))


def _canopen(url: SplitResult, query: Query) -> LinkFactory:
    from drivers.canopen import map as canopen_map
    from drivers.canopen.driver import CanopenLinks

    if "node" not in query:
        raise ControllerError(f"{url.geturl()!r} names no node; write canopen://socketcan/can0?node=5")
    objects = canopen_map.read_map(Path(query["map"])) if "map" in query else canopen_map.DEFAULT_MAP
    return CanopenLinks(url.netloc + url.path, _whole(query, "node", 0), _whole(query, "bitrate", 1_000_000), objects)


def _replay(url: SplitResult, query: Query) -> LinkFactory:
    return replay_links(Path(url.netloc + url.path))


_BUSES: dict[str, tuple[Callable[[SplitResult, Query], LinkFactory], frozenset[str]]] = {
    "modbus": (_modbus, frozenset({"unit", "map"})),
    "modbuss": (_modbus_tls, frozenset({"unit", "map", "ca", "cert", "key"})),
    "modbus+rtu": (_modbus_rtu, frozenset({"unit", "map", "baud"})),
    "canopen": (_canopen, frozenset({"node", "bitrate", "map"})),
    "replay": (_replay, frozenset()),
}
_IN_PROCESS = {"simulated": frozenset({"rig", "seed"})}
_EVERY_BUS = frozenset({"transcript"})


def connect(url: str, rig: Rig | None = None) -> Controller:
    """Controller at a URL.

    ============================================================ ==============================================
    ``simulated://?rig=rig.toml&seed=1``                         simulated rig in this process: the argument
                                                                 ``rig``, or the datasheet's, or the reference
    ``modbus://host:502?unit=1``                                 Modbus TCP
    ``modbuss://host:802?ca=ca.pem&cert=host.pem&key=host.key``  Modbus TCP in TLS
    ``modbus+rtu:///dev/ttyUSB0?baud=115200``                    Modbus RTU
    ``canopen://socketcan/can0?node=5&bitrate=1000000``          CANopen; also ``socketcand/host:port/can0``,
                                                                 ``udp_multicast/239.74.163.2:43113`` and
                                                                 ``virtual/name`` (one process)
    ``replay:///path/session.jsonl``                             a recorded session
    ============================================================ ==============================================

    Modbus and CANopen take ``map=map.toml``, a rig's own registers or objects; every bus takes
    ``transcript=session.jsonl``, which records the session.

    Raises
    ------
    ControllerError
        An unknown scheme or option; names the ones there are.
    BusError
        Nothing answers there.
    """
    parts = urlsplit(url)
    known = _IN_PROCESS.get(parts.scheme) or (_BUSES[parts.scheme][1] | _EVERY_BUS if parts.scheme in _BUSES else None)
    if known is None:
        schemes = ", ".join(f"{scheme}://" for scheme in (*_IN_PROCESS, *_BUSES))
        raise ControllerError(f"{url!r} has no known scheme; use one of {schemes}")
    query = {name: values[-1] for name, values in parse_qs(parts.query, keep_blank_values=True).items()}
    if unknown := sorted(set(query) - known):
        raise ControllerError(
            f"{url!r} has an unknown option {unknown[0]!r}; {parts.scheme}:// knows {', '.join(sorted(known))}"
        )
    if parts.scheme in _IN_PROCESS:
        return _simulated(parts, query, rig)
    links = _BUSES[parts.scheme][0](parts, query)
    if "transcript" in query:
        links = RecordingLinks(links, Path(query["transcript"]))
    return RemoteController(links)


def _host(url: SplitResult) -> str:
    if not url.hostname:
        raise ControllerError(f"{url.geturl()!r} names no host; write {url.scheme}://host:port")
    return url.hostname


def _port(url: SplitResult, default: int) -> int:
    try:
        return url.port or default
    except ValueError as error:
        raise ControllerError(f"{url.geturl()!r}: {error}") from error


def _whole(query: Query, name: str, default: int, least: int | None = None, most: int | None = None) -> int:
    try:
        value = int(query.get(name, default))
    except ValueError as error:
        raise ControllerError(f"the option {name} is a whole number, not {query[name]!r}") from error
    if (least is not None and value < least) or (most is not None and value > most):
        bounds = f"{least} to {most}" if most is not None else f"at least {least}"
        raise ControllerError(f"the option {name} is {bounds}, not {value}")
    return value


def _map(query: Query) -> RegisterMap:
    return read_map(Path(query["map"])) if "map" in query else DEFAULT_MAP
