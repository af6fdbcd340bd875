"""Whether a pooled connection to PostgreSQL still stands, told without asking the server."""

from __future__ import annotations

import select
from typing import Any

from sqlalchemy.exc import DisconnectionError

_GONE = "the server has closed the connection, or has said something that nobody asked for"


def stands(connection: Any, _record: Any, _proxy: Any) -> None:
    """Look at a connection that leaves the pool; SQLAlchemy makes a new one in place of one that is refused.

    An idle connection hears nothing until the server ends it, so whatever waits at its socket is a reason to leave
    it. A ping, which asks the server each time, was a fifth of all that idle workers cost; and neither of the two
    notices at once that a server's machine has vanished from the network: that is the business of the time limits.

    Raises
    ------
    DisconnectionError
        The connection is closed, or there is something to read.
    """
    if connection.closed:
        raise DisconnectionError(_GONE)
    waiting = select.poll()
    waiting.register(connection.fileno(), select.POLLIN | select.POLLHUP | select.POLLERR)
    if waiting.poll(0):
        raise DisconnectionError(_GONE)


def pool_options() -> dict[str, Any]:
    """Arguments of `sqlalchemy.create_engine` for such a pool; a ping where the system cannot look."""
    if not hasattr(select, "poll"):  # Windows
        return {"pool_pre_ping": True}
    return {"pool_pre_ping": False, "pool_events": [(stands, "checkout")]}
