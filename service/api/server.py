"""The process that serves the API."""

from __future__ import annotations

import gc
import logging
import os
import signal
import socket
import threading
import time

import uvicorn

from service import tracing
from service.access.loopback import FIRST_KEY, bound_to
from service.api.app import create_app
from service.api.state import Services
from service.config import Settings
from service.errors import ConfigurationError
from service.storage import keys

log = logging.getLogger(__name__)

GRACE_S = 5
"""Time that open requests have when the server ends."""
THREADS_S = 1.0
"""Time that their threads have then."""


def prepared(settings: Settings) -> tuple[Server, str]:
    """A server that is ready to run, and what to tell the operator ("" for nothing).

    Raises
    ------
    ConfigurationError
        The settings of TLS are not whole, or a service without keys would be behind a proxy.
    StorageError
        A database or the store cannot be used.
    """
    if (settings.tls_certificate is None) != (settings.tls_key is None):
        raise ConfigurationError("TLS needs both tls_certificate and tls_key; give the other one too")
    app = create_app(settings)
    services: Services = app.state.services
    with services.database.read() as session:
        any_key = keys.any_key(session)
    first_key = settings.here(FIRST_KEY)
    if settings.behind_proxy and not any_key:
        raise ConfigurationError(
            "behind_proxy needs an API key: without one this machine is served, and every caller of the proxy seems to "
            f"be of this machine; make the first key with {first_key}"
        )
    host, notice = bound_to(settings.host, any_key, first_key)
    options = uvicorn.Config(
        app,
        host=host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=settings.behind_proxy,
        forwarded_allow_ips=settings.trusted_proxies if settings.behind_proxy else "",
        ssl_certfile=settings.tls_certificate,
        ssl_keyfile=settings.tls_key,
        timeout_graceful_shutdown=GRACE_S,
    )
    return Server(options, services), notice


class Server(uvicorn.Server):
    """Prints its URL once it listens: the reader may be a program that waits for it."""

    def __init__(self, options: uvicorn.Config, services: Services) -> None:
        super().__init__(options)
        self.services = services

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen."""
        await super().startup(sockets)
        if self.started and self.servers:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            scheme = "https" if self.config.ssl_certfile else "http"
            print(f"{scheme}://{f'[{host}]' if ':' in host else host}:{port}", flush=True)

    def run(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until SIGTERM or Ctrl-C.

        Raises
        ------
        ConfigurationError
            The address is taken or not of this machine.
        """
        for number in (signal.SIGINT, signal.SIGTERM):
            # uvicorn sends itself the signal again when it has ended: by then there is nothing left to end
            signal.signal(number, lambda *_: None)
        gc.collect()
        gc.freeze()  # what lives as long as the process need not be looked at again and again
        gc.set_threshold(20_000, 20, 50)
        try:
            super().run(sockets)
        except SystemExit as error:
            raise ConfigurationError(
                f"cannot listen on {self.config.host} port {self.config.port}; give another host or port"
            ) from error


def end_without_threads() -> None:
    """End this process now if threads of requests hang: Python would wait for them, maybe for ever."""
    deadline = time.monotonic() + THREADS_S
    for thread in threading.enumerate():
        if thread is not threading.main_thread() and not thread.daemon:
            thread.join(max(deadline - time.monotonic(), 0.0))
            if thread.is_alive():
                log.warning("a request hangs, and is left behind")
                tracing.end()
                logging.shutdown()
                os._exit(0)
