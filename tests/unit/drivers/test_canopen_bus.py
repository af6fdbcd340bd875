"""A socketcand hub that is none, or falls silent: every wait for it ends, and the error says what to see to."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress

import pytest

from drivers.canopen.bus import open_network
from drivers.errors import BusError


@pytest.fixture
def peer(request: pytest.FixtureRequest) -> Iterator[str]:
    """Says one thing after the other, each once something was said to it; then it holds its peace."""

    def serve() -> None:
        with suppress(OSError):
            connection, _ = server.accept()
            with connection:
                for word in request.param:
                    connection.sendall(word)
                    connection.recv(256)
                over.wait(20)

    over = threading.Event()
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"socketcand/127.0.0.1:{server.getsockname()[1]}/can0"
        over.set()


@pytest.mark.parametrize(
    ("peer", "told"),
    [
        ((), "answers nothing to a connection"),
        ((b"< hi >",), "answers nothing to '< open can0 >'"),
        ((b"< hi >", b"< ok >"), "answers nothing to '< rawmode >'"),
        ((b"< hi >", b"< error could not open bus >"), "answers '< error could not open bus >'"),
        ((b"SSH-2.0-OpenSSH_9.6\r\n",), r"answers 'SSH-2.0-OpenSSH_9.6"),
        ((b"\xff\x00 no text at all",), "answers '\\\\xff"),
    ],
    indirect=["peer"],
)
def test_a_peer_that_is_no_hub_is_told_as_such_with_its_address(peer: str, told: str) -> None:
    began = time.monotonic()
    with pytest.raises(BusError) as error:
        open_network(peer)
    assert time.monotonic() - began < 10  # and not for ever
    for word in (peer, told, "see that"):
        assert word in str(error.value)


@pytest.mark.parametrize("peer", [(b"< hi >", b"< ok >", b"< ok >< frame 58", b"5 1.5 0102 >")], indirect=True)
def test_what_comes_right_behind_the_hub_s_last_answer_is_not_lost(peer: str) -> None:
    network = open_network(peer)
    heard: list[bytes] = []
    came = threading.Event()
    try:
        network.subscribe(0x585, lambda identifier, data, at: (heard.append(bytes(data)), came.set()))
        network.send_message(0x605, b"\1")
        assert came.wait(5)
        assert heard == [b"\1\2"]
    finally:
        network.disconnect()
