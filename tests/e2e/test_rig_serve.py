"""A simulated rig as a device process that prints where it is, serves, and leaves in good order."""

import json
import signal

import pytest

from drivers.url import connect
from tests.support.command import Running, refusal


@pytest.mark.parametrize("protocol", ["modbus", "modbus-rtu", "canopen"])
def test_a_served_rig_can_be_measured(protocol):
    from drivers.controller import Tone

    device = Running("rig", "serve", "--protocol", protocol, "--port", 0, "--seed", 1)
    try:
        url = device.first_line()
        controller = connect(url)
        with controller.lease("test"):
            point = controller.measure(Tone(axis=0, amplitude_a=0.05, periods=10, samples=1000, blocks=3))
        controller.close()
        assert abs(point.R[:, 1, 0].mean() - 0.05) < 1e-6
        device.interrupt(signal.SIGTERM)
        assert device.wait() == 0
    finally:
        device.end()


def test_a_withheld_effect_is_told_by_its_hash_alone(tmp_path):
    device = Running("rig", "serve", "--port", 0, "--withheld", 7, "--sealed", tmp_path / "sealed.json", "--json")
    try:
        assert device.process.stdout is not None
        text = ""
        while not text.endswith("}\n"):
            text += device.process.stdout.readline()
        told = json.loads(text)
        assert len(told["commitment"]) == 64
        assert json.loads((tmp_path / "sealed.json").read_text())["commitment"] == told["commitment"]
        assert json.loads(json.loads((tmp_path / "sealed.json").read_text())["truth"])["effect"] not in text
    finally:
        device.end()


def test_a_port_that_is_taken():
    device = Running("rig", "serve", "--port", 0)
    try:
        port = device.first_line().partition("?")[0].rpartition(":")[2]
        assert port in refusal("rig", "serve", "--port", port)
    finally:
        device.end()


def test_an_effect_that_does_not_exist():
    assert "gremlins" in refusal("rig", "serve", "--effect", "gremlins=3")
