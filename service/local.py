"""A whole service for as long as a context lasts: the API in a thread of this process, a worker beside.

However this process ends, the worker ends too: it holds the other end of a pipe.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from service.errors import ConfigurationError

if TYPE_CHECKING:
    import uvicorn

START_S = 60.0
END_S = 10.0


@contextmanager
def local_service(home: Path, worker: str) -> Iterator[str]:
    """URL of a service on a free port of the loopback; SQLite and the store are in ``home``.

    Settings of the environment do not reach it.

    Parameters
    ----------
    worker
        Its name: a job that a worker of this name has left in ``home`` goes on.

    Raises
    ------
    ConfigurationError, StorageError
        It cannot start; says why.
    """
    import uvicorn

    from service import logs
    from service.api.server import prepared
    from service.config import Settings
    from service.jobs.supervisor import Supervisor

    settings = Settings(home=home, host="127.0.0.1", port=0, worker_name=worker, log_level="error")
    logs.configure(settings.log_level, settings.log_format)
    announcing, _ = prepared(settings)
    server = uvicorn.Server(announcing.config)  # this one leaves stdout to the caller
    supervisor = Supervisor(settings)
    thread = threading.Thread(target=server.run, name="api", daemon=True)
    supervisor.start(announcing.services.database)
    try:
        thread.start()
        yield _url(server, thread)
    finally:
        supervisor.end()  # first: it stops what moves
        server.should_exit = True
        thread.join(END_S)


def _url(server: uvicorn.Server, thread: threading.Thread) -> str:
    deadline = time.monotonic() + START_S
    while not server.started:
        if not thread.is_alive() or time.monotonic() > deadline:
            raise ConfigurationError("the service cannot listen on the loopback; is the machine out of ports?")
        time.sleep(0.01)
    host, port = server.servers[0].sockets[0].getsockname()[:2]
    return f"http://{host}:{port}"
