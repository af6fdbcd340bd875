"""A device out of file descriptors lets hosts in again once it has some."""

import errno
import socket
from collections.abc import Callable

import pytest

from drivers.device.front import DeviceFront
from drivers.device.hub import CanHub
from drivers.device.machine import RigDevice
from drivers.device.modbus import TcpServer
from sim.reference import reference_rig


def modbus() -> TcpServer:
    return TcpServer(DeviceFront(RigDevice(reference_rig()), "big"))


@pytest.fixture
def exhausted(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each of the attempts to accept a connection was refused so far: the first two are."""
    tried: list[bool] = []

    def accept(listener: socket.socket, accept=socket.socket.accept) -> tuple[socket.socket, object]:
        tried.append(len(tried) < 2)
        if tried[-1]:
            raise OSError(errno.EMFILE, "Too many open files")
        return accept(listener)

    monkeypatch.setattr(socket.socket, "accept", accept)
    return tried


@pytest.mark.parametrize("serve", [modbus, CanHub])
def test_hosts_are_let_in_again(serve: Callable[[], TcpServer | CanHub], exhausted: list[bool]) -> None:
    served = serve()
    try:
        with socket.create_connection(("127.0.0.1", served.port), timeout=2.0) as host:
            host.sendall(bytes.fromhex("000100000006010300000001"))  # a register, please; the hub greets unasked
            assert host.recv(6)
        assert exhausted[:3] == [True, True, False]
    finally:
        served.close()
