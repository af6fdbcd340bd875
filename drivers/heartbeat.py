"""The host's sign of life, on a connection of its own: a counter every 50 ms, whatever else the bus is doing."""

from __future__ import annotations

import threading
import time
from contextlib import suppress

from drivers.errors import BusError
from drivers.link import Link, RefusedError

PERIOD_S = 0.05
COUNTS = 0xFFFF
"""After so many the count begins anew: a rig's own map may give it 16 bits."""


class Heartbeat:
    """Beats from its making until `close`.

    Parameters
    ----------
    link
        Its own connection, with short time-outs; closed at the end.
    token
        Of the lease that it feeds.
    """

    def __init__(self, link: Link, token: int, period_s: float = PERIOD_S) -> None:
        self._link = link
        self._token = token
        self._period_s = period_s
        self._end = threading.Event()
        self.refused = False
        """The device does not know the lease any more (it ran out, or the device restarted)."""
        self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End; the device then trips if anything is still excited."""
        self._end.set()
        self._thread.join(timeout=2.0)
        with suppress(Exception):
            self._link.close()

    def _beat(self) -> None:
        count = 0
        refusals = 0
        due = time.monotonic()
        while not self._end.is_set():
            count = count % COUNTS + 1
            try:
                self._link.write("beat", {"token": self._token, "count": count})
                refusals = 0
                due = max(due + self._period_s, time.monotonic())
            except RefusedError:
                refusals += 1
                self.refused = refusals > 3
                due = time.monotonic() + (self._period_s if self.refused else 0.01)
            except BusError:
                # at once: the watchdog runs
                due = time.monotonic() + 0.01
            self._end.wait(max(due - time.monotonic(), 0.0))
