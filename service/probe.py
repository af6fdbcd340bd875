"""Asks the API of this machine whether it is ready: a container's health check, exit status 0 or 1.

``python -m service.probe``, with the settings of the API in its environment.
"""

from __future__ import annotations

import ssl
import sys
from ipaddress import ip_address
from urllib.error import URLError
from urllib.request import HTTPSHandler, ProxyHandler, build_opener

from service.config import Settings, load

TIMEOUT_S = 4.0


def main() -> None:
    """Ask, and end."""
    sys.exit(0 if ready(load()) else 1)


def ready(settings: Settings) -> bool:
    """Whether the API of these settings answers that it is ready, by HTTPS where it has a certificate."""
    # the certificate is made out to the name that others use; this asks nobody but this machine
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    scheme = "https" if settings.tls_certificate else "http"
    opener = build_opener(ProxyHandler({}), HTTPSHandler(context=context))
    try:
        with opener.open(f"{scheme}://{_host(settings.host)}:{settings.port}/readyz", timeout=TIMEOUT_S) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError) as error:
        print(error, file=sys.stderr)
        return False


def _host(bound: str) -> str:
    try:
        address = ip_address(bound)
    except ValueError:
        return bound
    if address.is_unspecified:
        return "127.0.0.1" if address.version == 4 else "[::1]"
    return bound if address.version == 4 else f"[{bound}]"


if __name__ == "__main__":
    main()
