"""pymodbus's clients, where they keep to themselves what a host must know."""

from __future__ import annotations

import socket
import ssl

from pymodbus.client import ModbusTcpClient


class TcpClient(ModbusTcpClient):
    """pymodbus's TCP client, which keeps to itself why it cannot connect."""

    def connect(self) -> bool:
        """Connect; OSError where that fails."""
        if self.socket is None:
            parameters = self.comm_params
            self.socket = socket.create_connection((parameters.host, parameters.port), parameters.timeout_connect)
        return True


class TlsClient(ModbusTcpClient):
    """pymodbus's TCP client in TLS. Its own TLS client neither checks the host's name nor the frame's length."""

    def __init__(self, host: str, port: int, timeout: float, context: ssl.SSLContext) -> None:
        super().__init__(host, port=port, timeout=timeout, retries=0)
        self._context = context

    def connect(self) -> bool:
        """Connect, and check both certificates."""
        if self.socket is None:
            host = str(self.comm_params.host)
            plain = socket.create_connection((host, self.comm_params.port), timeout=2.0)
            try:
                self.socket = self._context.wrap_socket(plain, server_hostname=host)
            except BaseException:
                plain.close()
                raise
        return True
