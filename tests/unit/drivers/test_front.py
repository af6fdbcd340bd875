"""The device's objects as a bus sees them."""

import threading
import time

import pytest

from drivers.controller import Tone
from drivers.device import front as module
from drivers.device.front import DeviceFront
from drivers.device.machine import RigDevice
from drivers.objects import BY_NAME, Outcome
from drivers.packing import Values, with_crc
from sim.reference import reference_rig

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
LONG = Tone(axis=0, amplitude_a=0.02, periods=3000, samples=1_900_000, blocks=1)
TOKEN = 7


def _play(front: DeviceFront, tone: Tone, command: int) -> None:
    values: Values = {
        "token": TOKEN,
        "command": command,
        "axis": tone.axis,
        "amplitude_a": tone.amplitude_a,
        "periods": tone.periods,
        "samples": tone.samples,
        "blocks": tone.blocks,
        "settle_samples": tone.settle_samples,
        "raw": 0,
    }
    front.write("tone", with_crc(BY_NAME["tone"], values))


def test_the_end_of_a_tone_is_not_told_of_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host that lost sight of a tone may ask for the next one while the first one's result is still being packed."""
    device = RigDevice(reference_rig(), seed=1)
    device.acquire("host", attached=True, token=TOKEN)
    front = DeviceFront(device, "big")
    packing, go_on, pack = threading.Event(), threading.Event(), module.encode_lockin

    def slow(*arguments):
        packing.set()
        go_on.wait(10)
        return pack(*arguments)

    monkeypatch.setattr(module, "encode_lockin", slow)
    try:
        _play(front, TONE, 1)
        assert packing.wait(10)
        _play(front, LONG, 2)
        go_on.set()
        while front.read("status")["result"] != 1:
            time.sleep(0.001)
        status = front.read("status")
        assert (status["command"], status["outcome"]) == (2, Outcome.UNDER_WAY)
    finally:
        front.close()
        device.close()
