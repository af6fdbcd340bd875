"""What the URL of a controller says, as far as that can be told without opening a bus or a file."""

from __future__ import annotations

import re
from urllib.parse import SplitResult, parse_qs, urlsplit

from drivers.errors import AddressError
from drivers.modbus.framing import PARITIES
from sim.host_names import must_be_encodable

Query = dict[str, str]
_EVERY_BUS = frozenset({"transcript"})
_OPTIONS = {
    "simulated": frozenset({"rig", "seed"}),
    "modbus": _EVERY_BUS | {"unit", "map"},
    "modbuss": _EVERY_BUS | {"unit", "map", "ca", "cert", "key"},
    "modbus+rtu": _EVERY_BUS | {"unit", "map", "baud", "parity"},
    "canopen": _EVERY_BUS | {"node", "bitrate", "map"},
    "replay": _EVERY_BUS,
}
"""Options by scheme."""
_WHOLE = {
    ("simulated", "seed"): (0, 2**63 - 1),
    ("modbus", "unit"): (0, 255),
    ("modbuss", "unit"): (0, 255),
    # 0 is for all units, none of which answers, and those beyond 247 are reserved (Modbus over serial line 1.02, 2.2)
    ("modbus+rtu", "unit"): (1, 247),
    ("modbus+rtu", "baud"): (300, 4_000_000),
    ("canopen", "node"): (1, 127),  # CiA 301
    ("canopen", "bitrate"): (10_000, 1_000_000),
}
"""The least and the greatest of those that are whole numbers."""
PORTS = {"modbus": 502, "modbuss": 802}
"""Where a controller listens whose URL names no port."""
HIGHEST_PORT = 65535
_DIGITS = re.compile(r"-?[0-9]+")


def understood(url: str) -> tuple[SplitResult, Query]:
    """Parts and options of a URL; `drivers.url.connect` has a table of what it can be.

    Raises
    ------
    AddressError
        An unknown scheme or option, a part that is missing, a number out of its range; names what there is.
    """
    if not url.isprintable():  # urlsplit would leave some of that out without a word
        raise AddressError(f"{url!r} has a control character; leave it out")
    try:
        parts = urlsplit(url)
        _ = parts.port  # is read, and checked, there
    except ValueError as error:
        raise AddressError(f"{url!r}: {error}") from error
    if parts.scheme not in _OPTIONS:
        schemes = ", ".join(f"{scheme}://" for scheme in _OPTIONS)
        raise AddressError(f"{url!r} has no known scheme; use one of {schemes}")
    known = _OPTIONS[parts.scheme]
    given = parse_qs(parts.query, keep_blank_values=True)
    query = {name: values[-1] for name, values in given.items()}
    if unknown := sorted(set(query) - known):
        raise AddressError(
            f"{url!r} has an unknown option {unknown[0]!r}; {parts.scheme}:// knows {', '.join(sorted(known))}"
        )
    if repeated := sorted(name for name, values in given.items() if len(values) > 1):
        raise AddressError(f"{url!r} has the option {repeated[0]} more than once; leave one of them")
    _must_be_heard(parts)
    for name, text in query.items():
        if (parts.scheme, name) in _WHOLE:
            _must_be_whole(name, text, *_WHOLE[parts.scheme, name])
    if parts.scheme == "modbus+rtu" and "parity" in query and query["parity"] not in PARITIES:
        raise AddressError(f"the option parity is {', '.join(PARITIES)} or left out, not {query['parity']!r}")
    _must_name_a_place(parts, query)
    return parts, query


def _must_be_heard(url: SplitResult) -> None:
    """Refuse what no driver would read: with an option in the wrong place, another unit or rig than is meant moves."""
    text = url.geturl()
    if url.scheme in PORTS and "@" in url.netloc:
        raise AddressError(f"a {url.scheme}:// address holds no user or password; leave out what is before the @")
    if url.fragment:
        raise AddressError(f"{text!r}: what is behind # means nothing here; a # that belongs to an option is %23")
    if url.scheme in PORTS and url.path not in ("", "/"):
        raise AddressError(f"{text!r} has the path {url.path!r}; options are behind a question mark, as ?unit=1")
    if url.scheme == "simulated" and (url.netloc or url.path not in ("", "/")):
        raise AddressError(f"{text!r}: a datasheet is an option, write simulated://?rig=rig.toml")
    if url.scheme == "modbus+rtu" and url.netloc:
        raise AddressError(f"{text!r} has a host {url.netloc!r}; write modbus+rtu:///dev/ttyUSB0?baud=115200")


def _must_be_whole(name: str, text: str, least: int, most: int) -> None:
    try:
        if not _DIGITS.fullmatch(text):  # int() would read 1_0 as 10
            raise ValueError(text)
        value = int(text)
    except ValueError as error:
        raise AddressError(f"the option {name} is a whole number, not {text!r}") from error
    if not least <= value <= most:
        raise AddressError(f"the option {name} is {least} to {most}, not {value}")


def must_be_a_place(address: str, host: str, port: int | None, usual_port: int) -> None:
    """Refuse a host or port that cannot be one of a network.

    Raises
    ------
    AddressError
        Names the address, and what is wrong with it.
    """
    try:
        must_be_encodable(host)
    except ValueError as error:
        raise AddressError(f"{address!r}: {error}") from error
    if port is not None and not 1 <= port <= HIGHEST_PORT:
        raise AddressError(f"{address!r} has the port {port}; give 1 to {HIGHEST_PORT}, or none for {usual_port}")


def _must_name_a_place(url: SplitResult, query: Query) -> None:
    if url.scheme in PORTS:
        if not url.hostname:
            raise AddressError(f"{url.geturl()!r} names no host; write {url.scheme}://host:port")
        must_be_a_place(url.geturl(), url.hostname, url.port, PORTS[url.scheme])
    if url.scheme == "modbus+rtu" and not url.path:
        raise AddressError(f"{url.geturl()!r} names no serial port; write modbus+rtu:///dev/ttyUSB0?baud=115200")
    if url.scheme == "canopen":
        from drivers.canopen.bus import bus_arguments

        if "node" not in query:
            raise AddressError(f"{url.geturl()!r} names no node; write canopen://socketcan/can0?node=5")
        bus_arguments(url.netloc + url.path)
