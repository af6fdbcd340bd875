"""A simulated rig as a device process that prints where it is, serves, and leaves in good order."""

import json
import signal

import pytest

from drivers.errors import BusError
from drivers.modbus.driver import tcp_links
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


def test_a_silent_host_is_given_a_fifth_of_a_second():
    device = Running("rig", "serve")
    try:
        identity = tcp_links("127.0.0.1", int(device.first_line().partition("?")[0].rpartition(":")[2])).link()
        assert identity.read("identity")["watchdog_s"] == 0.2
        identity.close()
    finally:
        device.end()


@pytest.mark.parametrize("protocol", ["modbus", "modbus-rtu", "canopen"])
def test_faults_on_purpose(protocol):
    """Everything that a host says is lost, so that nobody connects."""
    device = Running("rig", "serve", "--protocol", protocol, "--faults", "drop=1.0", "--fault-seed", 3)
    try:
        with pytest.raises(BusError):
            connect(device.first_line())
    finally:
        device.end()


def test_what_is_withheld_is_told_by_its_hash_alone(tmp_path):
    device = Running("rig", "serve", "--port", 0, "--withheld", 1, "--sealed", tmp_path / "sealed.json", "--json")
    try:
        assert device.process.stdout is not None
        text = ""
        while not text.endswith("}\n"):
            text += device.process.stdout.readline()
        told = json.loads(text)
        assert len(told["commitment"]) == 64
        sealed = json.loads((tmp_path / "sealed.json").read_text())
        assert sealed["commitment"] == told["commitment"]
        (hidden,) = json.loads(sealed["truth"])["effects"]
        assert told["datasheet"] == str(tmp_path / "sealed.rig.toml")
        assert hidden not in text + (tmp_path / "sealed.rig.toml").read_text()
    finally:
        device.end()


def test_a_known_effect_beside_what_is_withheld(tmp_path):
    words = ("--withheld", 1, "--sealed", tmp_path / "sealed.json", "--effect", "loop_delay")
    assert "--rig" in refusal("rig", "serve", *words, status=2)


def test_a_port_that_is_taken():
    device = Running("rig", "serve", "--port", 0)
    try:
        port = device.first_line().partition("?")[0].rpartition(":")[2]
        assert port in refusal("rig", "serve", "--port", port)
    finally:
        device.end()
