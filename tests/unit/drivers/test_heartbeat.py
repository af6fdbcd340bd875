"""The host's sign of life goes on for as long as the lease does."""

from __future__ import annotations

import threading
from typing import Any

from drivers.heartbeat import Heartbeat
from drivers.modbus.codec import entry_bytes
from drivers.modbus.map import parse_map
from drivers.packing import Values

MAP = """
[objects."beat.count"]
type = "U16"
[objects."beat.crc"]
absent = true
"""


def test_a_count_of_16_bits_beats_for_longer_than_an_hour() -> None:
    entry = parse_map(MAP).of("beat")[1]
    beats, enough = list[bytes](), threading.Event()

    class Link:
        def write(self, group: str, values: Values) -> None:
            beats.append(entry_bytes(entry, values["count"], "big"))
            if len(beats) > 72_000:
                enough.set()

        def close(self) -> None:
            pass

    link: Any = Link()
    heartbeat = Heartbeat(link, token=7, period_s=0.0)
    while not enough.wait(0.1) and heartbeat._thread.is_alive():
        pass
    heartbeat.close()
    assert enough.is_set()
    assert all(beats[k] != beats[k + 1] for k in range(72_000))
