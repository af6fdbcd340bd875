"""Which controllers a rig may have: an address on a bus, never a file of this machine that a caller names."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from service.api.problems import UnprocessableError
from service.config import Settings

SCHEMES = ("modbus", "modbuss", "modbus+rtu", "canopen", "simulated")
IN_PROCESS = ("simulated",)
"""Of rigs that are simulated by whoever connects to them: every connection has a rig of its own."""
FILES = ("map", "ca", "cert", "key", "rig")
REFUSED = ("transcript",)
FOLDER = "controllers"
"""Folder in the service's home whose files a controller's URL may name."""


def checked_url(url: str, settings: Settings) -> str:
    """The URL of a controller, or empty.

    Raises
    ------
    UnprocessableError
        An unknown scheme, or a file that is not one of the service's.
    """
    if not url:
        return url
    try:
        parts = urlsplit(url)
        _ = parts.port
        query = parse_qs(parts.query, keep_blank_values=True)
    except ValueError as error:
        raise UnprocessableError(f"the controller's URL cannot be read: {error}") from error
    if parts.scheme not in SCHEMES:
        raise UnprocessableError(f"a controller's URL begins with one of {', '.join(f'{s}://' for s in SCHEMES)}")
    if parts.scheme in ("modbus", "modbuss") and not parts.hostname:
        raise UnprocessableError(f"{url!r} names no host; write {parts.scheme}://host:port")
    folder = (settings.home.absolute() / FOLDER).resolve()
    for name, values in query.items():
        if name in REFUSED:
            raise UnprocessableError(f"the option {name} is for the command line; leave it out")
        if name in FILES and any(not Path(value).resolve().is_relative_to(folder) for value in values):
            raise UnprocessableError(f"the option {name} must name a file in {folder}; have it put there")
    return url
