"""Which controllers a rig may have: an address on a bus, never a file of this machine that a caller names."""

from __future__ import annotations

from os.path import normpath
from pathlib import Path

from drivers.address import understood
from drivers.errors import ControllerError
from service.api.problems import UnprocessableError
from service.config import Settings

SCHEMES = ("modbus", "modbuss", "modbus+rtu", "canopen", "simulated")
IN_PROCESS = ("simulated",)
"""Of rigs that are simulated by whoever connects to them: every connection has a rig of its own."""
OF_ONE = ("modbus+rtu",)
"""Of lines that are open for one process at a time."""
FILES = ("map", "ca", "cert", "key", "rig")
REFUSED = ("transcript",)
DEVICES = "/dev"
"""Where serial ports are: a port elsewhere would be a file that is opened for whoever names it."""


def checked_url(url: str, settings: Settings) -> str:
    """The URL of a controller, or empty.

    Raises
    ------
    UnprocessableError
        An unknown scheme or option, a number out of its range, or a file that is not one of the service's.
    """
    if not url:
        return url
    if url.partition(":")[0].lower() not in SCHEMES:
        raise UnprocessableError(f"a controller's URL begins with one of {', '.join(f'{s}://' for s in SCHEMES)}")
    try:
        parts, query = understood(url)
    except ControllerError as error:
        raise UnprocessableError(f"the controller's URL: {error}") from error
    folder = settings.controllers.resolve()
    for name, value in query.items():
        if name in REFUSED:
            raise UnprocessableError(f"the option {name} is for the command line; leave it out")
        if name in FILES and not Path(value).resolve().is_relative_to(folder):
            raise UnprocessableError(f"the option {name} must name a file in {folder}; have it put there")
    if parts.scheme == "modbus+rtu" and not Path(normpath(parts.path)).is_relative_to(DEVICES):
        raise UnprocessableError(f"{parts.path} is no serial port; one is in {DEVICES}, as /dev/ttyUSB0")
    return url
