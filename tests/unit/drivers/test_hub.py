"""The bus in software, whatever one of its clients does."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from drivers.device import hub as module
from drivers.device.hub import GREETING_S, CanHub, Frame

COPIES = 1000
"""Frames on the line for each one of a flood."""
STOP = 0x80


@pytest.fixture
def hub() -> Iterator[CanHub]:
    found = CanHub(spoil=lambda frame: [(0.0, frame)] * (1 if frame.identifier == STOP else COPIES))
    yield found
    found.close()


def opened(hub: CanHub, receive_bytes: int | None = None) -> socket.socket:
    host = socket.socket()
    if receive_bytes is not None:
        host.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    host.settimeout(5.0)
    host.connect((hub.host, hub.port))
    for said, answer in ((b"", b"< hi >"), (b"< open can0 >", b"< ok >"), (b"< rawmode >", b"< ok >")):
        host.sendall(said)
        assert host.recv(len(answer), socket.MSG_WAITALL) == answer
    time.sleep(2 * GREETING_S)
    return host


def hears(host: socket.socket, wanted: bytes) -> bool:
    """Whether that comes before the connection ends."""
    last = b""
    while wanted not in last:
        if not (chunk := host.recv(1 << 16)):
            return False
        last = last[-100:] + chunk
    return True


def test_a_client_that_never_reads_is_dropped_and_stops_nobody(hub: CanHub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BACKLOG_BYTES", 1 << 16, raising=False)
    with ExitStack() as stack:
        stalled, reader = (stack.enter_context(opened(hub, size)) for size in (4096, None))
        for number in range(0x100, 0x100 + 100):  # more than a connection of Linux holds
            hub.send(Frame(number, bytes(8)))
            assert hears(reader, b"< frame %03X " % number)
        second = stack.enter_context(opened(hub))
        second.sendall(b"< send %x 1 1 >" % STOP)
        assert hears(reader, b"< frame %03X " % STOP)
        assert not hears(stalled, b"< frame %03X " % STOP)


def test_a_client_that_lags_hears_everything_later(hub: CanHub) -> None:
    """What its connection does not take at once comes when it reads again, though nothing more is sent."""
    with opened(hub, 4096) as lags, opened(hub) as reader:
        for number in range(0x100, 0x100 + 65):
            hub.send(Frame(number, bytes(8)))
            assert hears(reader, b"< frame %03X " % number)
        hub.send(Frame(STOP, b""))
        assert hears(lags, b"< frame %03X " % STOP)
