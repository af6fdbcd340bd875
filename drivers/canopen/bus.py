"""Opening a CAN bus by its address: python-can underneath, whose errors end up in the thread that asked.

``socketcan/can0``, ``socketcand/host:port/can0``, ``udp_multicast/239.74.163.2:43113``, ``virtual/name``
"""

from __future__ import annotations

import logging
import socket
import time
from typing import Any

import can
import canopen
from can.interfaces.socketcand.socketcand import SocketCanDaemonBus

from drivers.errors import BusError, ControllerError

INTERFACES = ("socketcan", "socketcand", "udp_multicast", "virtual")

# What a bus or a node does wrong is raised, and counted, by those who retry; the libraries' logs would repeat it.
for _name in ("canopen", "can"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)


def bus_arguments(address: str, bitrate: int = 1_000_000) -> dict[str, Any]:
    """Arguments of `can.Bus` for an address.

    >>> bus_arguments("socketcan/can0")
    {'interface': 'socketcan', 'channel': 'can0'}

    Raises
    ------
    ControllerError
        An unknown interface, or a part is missing.
    """
    interface, _, rest = address.partition("/")
    if interface not in INTERFACES or not rest:
        raise ControllerError(
            f"cannot read the CAN bus {address!r}; write socketcan/can0, socketcand/host:port/can0, "
            "udp_multicast/239.74.163.2:43113 or virtual/name"
        )
    if interface in ("socketcan", "virtual"):
        return {"interface": interface, "channel": rest}
    place, _, channel = rest.partition("/")
    host, _, port = place.partition(":")
    try:
        number = int(port) if port else (29536 if interface == "socketcand" else 43113)
    except ValueError:
        raise ControllerError(f"the port in {address!r} is not a number") from None
    if interface == "socketcand":
        return {"interface": interface, "host": host, "port": number, "channel": channel or "can0", "tcp_tune": True}
    return {"interface": interface, "channel": host, "port": number}


def open_network(address: str, bitrate: int = 1_000_000) -> canopen.Network:
    """Network on a bus.

    Raises
    ------
    BusError
        The bus cannot be opened.
    """
    arguments = bus_arguments(address, bitrate)
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # how long leaving the bus may take
    network.listeners.append(_KeepsQuiet())  # type: ignore[arg-type]
    try:
        network.bus = _reachable(arguments)
        network.connect()
    except (can.CanError, OSError, TimeoutError, ValueError) as error:
        raise BusError(f"cannot open the CAN bus {address}: {error}") from error
    return network


def _reachable(arguments: dict[str, Any]) -> can.BusABC:
    if arguments["interface"] != "socketcand":
        return can.Bus(**arguments)
    # python-can would try for ten seconds, at full speed
    socket.create_connection((arguments["host"], arguments["port"]), timeout=1.0).close()
    return _SocketcandBus(**{k: v for k, v in arguments.items() if k != "interface"})  # type: ignore[no-untyped-call]


class _KeepsQuiet(can.Listener):
    """An error of the receiving thread is kept by the notifier, and raised at the next sending."""

    def on_message_received(self, msg: can.Message) -> None:
        """Frames are for the others."""

    def on_error(self, exc: Exception) -> None:
        """Wait, so that a dead interface is not asked at full speed."""
        time.sleep(0.05)


class _SocketcandBus(SocketCanDaemonBus):
    """python-can's, which takes a connection that was closed for silence."""

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message, filtered = super()._recv_internal(timeout)  # type: ignore[no-untyped-call]
        if message is None:
            connection: socket.socket = self._SocketCanDaemonBus__socket  # type: ignore[attr-defined]
            try:
                if connection.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b"":
                    raise can.CanError("socketcand has closed the connection")
            except BlockingIOError:
                pass
        return message, filtered
