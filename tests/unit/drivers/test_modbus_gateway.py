"""What a gateway says, or an address where nobody answers, is told with the unit and what to do."""

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.errors import BusError
from drivers.modbus.driver import tcp_links


@contextmanager
def gateway(exception: int) -> Iterator[int]:
    """Port of a gateway that answers every request of one connection with this exception."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                while frame := connection.recv(260):
                    transaction, _, _, unit, function = struct.unpack(">HHHBB", frame[:8])
                    connection.sendall(struct.pack(">HHHBBB", transaction, 0, 3, unit, function | 0x80, exception))

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            thread.join()


@pytest.mark.parametrize(("exception", "said"), [(10, "no way to unit 7; correct unit"), (11, "no unit 7 answers")])
def test_a_gateway_that_does_not_reach_the_unit_is_told_as_that(exception: int, said: str) -> None:
    with gateway(exception) as port:
        links = tcp_links("127.0.0.1", port, 7)
        link = links.link()
        try:
            with pytest.raises(BusError, match=f"exception {exception}: .*{said}"):
                link.read("status")
        finally:
            link.close()
    assert links.description == f"modbus://127.0.0.1:{port}?unit=7"


def test_an_address_where_nobody_listens_is_told_with_the_reason() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(BusError, match="cannot connect: Connection refused; see that the controller is on"):
        tcp_links("127.0.0.1", port, 7).link().read("status")


def test_a_unit_that_is_silent_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        link = tcp_links("127.0.0.1", silent.getsockname()[1], 7).link(urgent=True)
        with pytest.raises(BusError, match="no answer from unit 7; see that the controller is on"):
            link.read("status")
