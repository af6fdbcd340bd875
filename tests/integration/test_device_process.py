"""A device that a program starts for itself ends with it, however that program ends, and with its excitation off."""

import os
import signal
from pathlib import Path

import pytest

from drivers.errors import ControllerError
from drivers.url import connect
from service.device_process import device_process
from tests.support.processes import Process, read_events, wait_for

HOST = """
import sys
from drivers.controller import Tone
from drivers.url import connect
from service.device_process import device_process

with device_process("--real-time", "--events", sys.argv[1]) as device:
    controller = connect(device.url)
    with controller.lease("host"):
        print(device.pid, flush=True)
        controller.measure(Tone(axis=0, amplitude_a=0.05, periods=20, samples=10000, blocks=60))
"""


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_it_serves_as_long_as_the_context() -> None:
    with device_process("--protocol", "canopen", "--seed", "3") as device:
        controller = connect(device.url)
        assert controller.capabilities().axes == ("xA", "xB", "yA", "yB")
        controller.close()
        assert _alive(device.pid)
    assert not _alive(device.pid)


def test_it_ends_with_an_error() -> None:
    with pytest.raises(RuntimeError, match="disk full"), device_process() as device:
        raise RuntimeError("disk full")
    assert not _alive(device.pid)


def test_a_device_that_does_not_start_says_why() -> None:
    said = r"device process ended with status 2: .*gremlins"
    with pytest.raises(ControllerError, match=said), device_process("--effect", "gremlins"):
        pass


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_it_ends_with_a_program_that_is_killed_in_the_middle_of_a_tone(number: int, tmp_path: Path) -> None:
    events = tmp_path / "events.jsonl"
    events.touch()
    host = Process("-c", HOST, str(events))
    device = int(host.said)
    try:
        wait_for(lambda: any("excitation on" in str(e["text"]) for e in read_events(events)), "excitation")
        host.kill(number)
        host.wait()
        wait_for(lambda: not _alive(device), "the end of the device")
        assert any("excitation off" in str(e["text"]) for e in read_events(events))
    finally:
        host.end()
