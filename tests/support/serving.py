"""The real application behind a real socket, in a thread; no worker, so that a test decides what becomes of a job."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import uvicorn

from service.access import keys
from service.access.keys import Scope
from service.api.server import prepared
from service.api.state import Services
from service.config import Settings
from service.storage import keys as key_rows
from service.storage.ids import new_id


@dataclass
class Serving:
    """A service that answers."""

    url: str
    services: Services

    def key(self, scope: Scope = Scope.operator) -> str:
        """A new key."""
        record, key = keys.issue(new_id("key"), f"test {scope}", scope)
        with self.services.database.write() as session:
            key_rows.add(session, key_rows.row(record, "test"))
        return key


@contextmanager
def serving(settings: Settings) -> Iterator[Serving]:
    """Serve until the end of the block."""
    server, _ = prepared(settings)
    thread = threading.Thread(target=uvicorn.Server.run, args=(server,))  # its own run is for the main thread
    thread.start()
    try:
        deadline = time.monotonic() + 20
        while not server.started:
            assert thread.is_alive(), "the server ended"
            assert time.monotonic() < deadline, "the server did not start"
            time.sleep(0.01)
        host, port = server.servers[0].sockets[0].getsockname()[:2]
        yield Serving(f"http://{host}:{port}", server.config.app.state.services)
    finally:
        server.should_exit = True
        thread.join(20)
