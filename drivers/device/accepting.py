"""Connections to a server of the device, as they come."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

ACCEPT_AGAIN_S = 0.1


def accepted(listener: socket.socket, closing: threading.Event) -> Iterator[socket.socket]:
    """Connections, each sending at once what is written, until ``closing`` is set; the listener has a timeout."""
    while not closing.is_set():
        try:
            connection, _ = listener.accept()
        except TimeoutError:
            continue
        except OSError:  # too many open files: they are closed some time
            closing.wait(ACCEPT_AGAIN_S)
            continue
        connection.settimeout(None)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        yield connection
