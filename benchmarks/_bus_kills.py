"""How long the excitation outlives its host: hosts killed with SIGKILL, times measured at the device."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from drivers.controller import State
from drivers.url import connect

HOST = """
import sys
from drivers.controller import Tone
from drivers.url import connect
controller = connect(sys.argv[1])
with controller.lease("victim", seconds=0.5):
    print("leased", flush=True)
    controller.measure(Tone(axis=0, amplitude_a=0.05, periods=20, samples=10000, blocks=60))
"""


def run(kills: int, protocol: str) -> list[float]:
    """Seconds from each kill to the end of the excitation."""
    with tempfile.TemporaryDirectory() as folder:
        events = Path(folder) / "events.jsonl"
        device = subprocess.Popen(
            [sys.executable, "-m", "drivers.device", "--protocol", protocol, "--real-time", "--events", str(events)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert device.stdout is not None
        url = device.stdout.readline().strip()
        try:
            return [_kill_one(url, events) for _ in range(kills)]
        finally:
            device.terminate()
            device.wait()
            device.stdout.close()


def _kill_one(url: str, events: Path) -> float:
    before = len(events.read_text().splitlines())
    host = subprocess.Popen([sys.executable, "-c", HOST, url], stdout=subprocess.PIPE, text=True)
    assert host.stdout is not None
    _wait(lambda: _after(events, before, "excitation on"))
    time.sleep(0.3)
    killed = time.monotonic()
    host.send_signal(signal.SIGKILL)
    _wait(lambda: _after(events, before, "excitation off"))
    off = _after(events, before, "excitation off")
    host.wait()
    host.stdout.close()
    successor = connect(url)
    _wait(lambda: not successor.status().lease_holder)
    assert successor.status().state is State.TRIPPED
    with successor.lease("next"):
        successor.acknowledge()
    successor.close()
    return off - killed


def _after(events: Path, line: int, text: str) -> float:
    for row in events.read_text().splitlines()[line:]:
        if text in row:
            return float(json.loads(row)["monotonic_s"])
    return 0.0


def _wait(condition: Callable[[], object], seconds: float = 30.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError("nothing happened")
        time.sleep(0.005)
