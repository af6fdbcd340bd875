"""Opening a CAN bus by its address: python-can underneath, whose errors end up in the thread that asked.

``socketcan/can0``, ``socketcand/host:port/can0``, ``udp_multicast/239.74.163.2:43113``, ``virtual/name``
"""

from __future__ import annotations

import logging
import select
import socket
import time
from collections import deque
from collections.abc import Iterable
from itertools import islice
from typing import Any

import can
import canopen
from can.interfaces.socketcand.socketcand import convert_can_message_to_ascii_message

from drivers.address import must_be_a_place
from drivers.errors import AddressError, BusError
from sim.errors import reason

INTERFACES = ("socketcan", "socketcand", "udp_multicast", "virtual")
PORTS = {"socketcand": 29536, "udp_multicast": 43113}
"""Of those that are reached over a network, where none is named."""

HUB_PATIENCE_S = 1.0
"""How long a socketcand hub may take to accept a connection, for each of its answers, and for a frame."""
TOGETHER = 8
"""Frames that leave in one go where the interface is a network connection: a millisecond of a line at 1 Mbit/s."""

# What a bus or a node does wrong is raised, and counted, by those who retry; the libraries' logs would repeat it.
for _name in ("canopen", "can"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)


def has_a_line(address: str) -> bool:
    """Whether frames of a bus go over a line with a bit rate; those of a network or of this process do not.

    >>> [has_a_line(address) for address in ("socketcan/can0", "socketcand/host/can0", "virtual/rig")]
    [True, True, False]
    """
    return address.partition("/")[0] in ("socketcan", "socketcand")


def bus_arguments(address: str) -> dict[str, Any]:
    """Arguments of `can.Bus` for an address.

    >>> bus_arguments("socketcan/can0")
    {'interface': 'socketcan', 'channel': 'can0'}

    Raises
    ------
    AddressError
        An unknown interface, a part that is missing, or a host or port that no network has.
    """
    interface, _, rest = address.partition("/")
    if interface not in INTERFACES or not rest:
        raise AddressError(
            f"cannot read the CAN bus {address!r}; write socketcan/can0, socketcand/host:port/can0, "
            "udp_multicast/239.74.163.2:43113 or virtual/name"
        )
    if interface in ("socketcan", "virtual"):
        return {"interface": interface, "channel": rest}
    place, _, channel = rest.partition("/")
    host, _, port = place.partition(":")
    usual = PORTS[interface]
    try:
        number = int(port) if port else usual
    except ValueError:
        raise AddressError(f"the port in {address!r} is not a number") from None
    must_be_a_place(address, host, number, usual)
    if interface == "socketcand":
        return {"interface": interface, "host": host, "port": number, "channel": channel or "can0"}
    return {"interface": interface, "channel": host, "port": number}


def open_network(address: str) -> canopen.Network:
    """Network on a bus.

    Raises
    ------
    BusError
        The bus cannot be opened.
    """
    arguments = bus_arguments(address)
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # how long leaving the bus may take
    network.listeners.append(_KeepsQuiet())  # type: ignore[arg-type]
    try:
        network.bus = _reachable(arguments)
        network.connect()
    except (can.CanError, OSError, TimeoutError, ValueError) as error:
        raise BusError(
            f"cannot open the CAN bus {address}: {reason(error)}; see that it is up, and that its address is right"
        ) from error
    return network


def _reachable(arguments: dict[str, Any]) -> can.BusABC:
    if arguments["interface"] != "socketcand":
        return can.Bus(**arguments)
    return _SocketcandBus(arguments["host"], arguments["port"], arguments["channel"])


class _KeepsQuiet(can.Listener):
    """An error of the receiving thread is kept by the notifier, and raised at the next sending."""

    def on_message_received(self, msg: can.Message) -> None:
        """Frames are for the others."""

    def on_error(self, exc: Exception) -> None:
        """Wait, so that a dead interface is not asked at full speed."""
        time.sleep(0.05)


class _SocketcandBus(can.BusABC):
    """A bus behind a socketcand hub, with an end to every wait.

    python-can's own waits for ever for the answers of what is no hub, tries for ten seconds where nobody listens, takes
    a closed connection for silence, and a kilobyte, and four system calls, at a time.
    """

    def __init__(self, host: str, port: int, channel: str) -> None:
        self.channel_info = f"socketcand on {channel}@{host}:{port}"
        self._came: deque[can.Message] = deque()
        self._begun = ""
        self._connection = socket.create_connection((host, port), timeout=HUB_PATIENCE_S)
        try:
            self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._greet(channel)
            super().__init__(channel=channel)
        except BaseException:
            self._connection.close()
            raise

    def _greet(self, channel: str) -> None:
        for said, answer in (("", "< hi >"), (f"< open {channel} >", "< ok >"), ("< rawmode >", "< ok >")):
            self._connection.sendall(said.encode("ascii"))
            heard = self._heard()[:40]
            if heard != answer:
                told = f"answers {heard!r}" if heard else "answers nothing"
                asked = f"to {said!r}" if said else "to a connection"
                raise can.CanError(f"what listens there {told} {asked}, where a socketcand hub says {answer!r}")

    def _heard(self) -> str:
        """What is said up to the end of a word of the hub's, as far as it comes in time; more of it is kept."""
        deadline = time.monotonic() + HUB_PATIENCE_S
        while ">" not in self._begun and (left := deadline - time.monotonic()) > 0:
            if not select.select([self._connection], [], [], left)[0]:
                break
            chunk = self._connection.recv(256)
            self._begun += chunk.decode("ascii", "backslashreplace")
            if not chunk or len(self._begun) > 256:  # no hub says so much
                break
        word, end, self._begun = self._begun.partition(">")
        return word + end

    def shutdown(self) -> None:
        """Leave the bus; safe twice."""
        super().shutdown()
        self._connection.close()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._came:
            try:
                if not select.select([self._connection], [], [], timeout)[0]:
                    return None, False
                text = self._connection.recv(65536).decode("ascii")
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
            except (OSError, ValueError) as error:
                raise can.CanError(f"socketcand: {reason(error)}") from error
            if not text:
                raise can.CanError("socketcand has closed the connection")
            *whole, self._begun = (self._begun + text).split(">")
            self._came.extend(filter(None, map(_message, whole)))
        return (self._came.popleft() if self._came else None), False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame."""
        self.send_together([msg])

    def send_together(self, frames: Iterable[can.Message]) -> None:
        """Send frames, one behind the other, in one go."""
        self._connection.sendall("".join(map(convert_can_message_to_ascii_message, frames)).encode("ascii"))


def send_all(network: canopen.Network, cob_id: int, contents: Iterable[bytes]) -> None:
    """Send frames of one identifier, as few at a time as the interface likes."""
    bus = network.bus
    if not isinstance(bus, _SocketcandBus):
        for data in contents:
            network.send_message(cob_id, data)
        return
    frames = (can.Message(arbitration_id=cob_id, is_extended_id=False, data=data) for data in contents)
    with network.send_lock:
        while some := list(islice(frames, TOGETHER)):  # the first are on the line while the others are made
            bus.send_together(some)
    network.check()


def _message(text: str) -> can.Message | None:
    """Frame of ``< frame 585 1.5 0102``; None for what is none."""
    words = text.split()
    if len(words) < 3 or words[0] != "<" or words[1] not in ("frame", "error"):
        return None
    try:
        if words[1] == "error":
            identifier = int(words[2], 16) & 0x1FFFFFFF
            return can.Message(arbitration_id=identifier, is_error_frame=True, is_extended_id=True, data=b"\0")
        data = bytes.fromhex(words[4]) if len(words) > 4 else b""
        return can.Message(
            timestamp=float(words[3]), arbitration_id=int(words[2], 16), is_extended_id=len(words[2]) != 3, data=data
        )
    except (ValueError, IndexError):
        return None
