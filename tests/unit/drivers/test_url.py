"""Addresses of controllers: what is understood, and what is refused before anything is opened."""

import re
from dataclasses import replace

import pytest

from drivers.canopen.bus import bus_arguments
from drivers.errors import BusError, ControllerError
from drivers.simulated.driver import SimulatedController
from drivers.url import connect
from sim.reference import reference_datasheet, reference_rig
from sim.rig_file import to_toml
from sim.withheld.given import Given


def test_simulated_takes_rig_and_seed() -> None:
    controller = connect("simulated://?seed=4", rig=reference_rig())
    assert isinstance(controller, SimulatedController)
    assert controller.capabilities().axes == ("xA", "xB", "yA", "yB")
    controller.close()


def test_a_rig_simulated_from_a_datasheet_has_noise_as_large_beside_its_limits_as_the_reference_rig(tmp_path) -> None:
    """Without any, nothing that is left of a model could be told from noise."""
    sheet = replace(reference_datasheet(), displacement_limit_m=40e-6, current_limit_a=12.0)
    (tmp_path / "rig.toml").write_text(to_toml(sheet))
    controller = connect(f"simulated://?rig={tmp_path / 'rig.toml'}&seed=1")
    assert isinstance(controller, SimulatedController)
    noise, usual = controller._device.rig.noise, reference_rig().noise
    assert noise.displacement_m == pytest.approx(0.5 * usual.displacement_m)
    assert noise.current_a == pytest.approx(2.0 * usual.current_a)
    assert noise.displacement_step_m == pytest.approx(0.5 * usual.displacement_step_m)
    assert noise.current_step_a == pytest.approx(2.0 * usual.current_step_a)
    assert Given(sheet).rig().noise == noise
    controller.close()


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("profibus://x", "no known scheme; use one of simulated://, modbus://"),
        ("modbus://host?speed=1", "unknown option 'speed'; modbus:// knows map, transcript, unit"),
        ("modbus://", "names no host"),
        ("modbus://host:port", "port"),
        ("modbus://host?unit=one", "unit is a whole number, not 'one'"),
        ("modbus://host?unit=256", "unit is 0 to 255, not 256"),
        ("modbuss://host?unit=-1", "unit is 0 to 255, not -1"),
        ("modbus+rtu://", "names no serial port"),
        ("modbus+rtu:///dev/ttyUSB0?unit=0", "unit is 1 to 247, not 0"),
        ("modbus+rtu:///dev/ttyUSB0?baud=0", "baud is 300 to 4000000, not 0"),
        ("canopen://socketcan/can0", "names no node"),
        ("canopen://socketcan/can0?node=128", "node is 1 to 127, not 128"),
        ("canopen://socketcan/can0?node=0", "node is 1 to 127, not 0"),
        ("canopen://socketcan/can0?node=5&bitrate=0", "bitrate is 10000 to 1000000, not 0"),
        ("modbus://[::1", "Invalid IPv6 URL"),
        ("modbus://ho\tst", "'modbus://ho\\tst' has a control character"),
        ("simulated://?seed=-1", "seed is 0 to"),
        ("canopen://pigeon/can0?node=1", "cannot read the CAN bus"),
        ("canopen://socketcan/?node=1", "cannot read the CAN bus"),
        ("modbuss://host?ca=/nowhere.pem", "certificates"),
        ("replay:///nowhere.jsonl", "cannot read the transcript"),
        ("modbus://host?map=/nowhere.toml", "cannot read the map"),
        ("simulated://?seed=many", "seed is a whole number"),
    ],
)
def test_wrong_url_is_refused_in_one_line(url: str, message: str) -> None:
    with pytest.raises(ControllerError, match=re.escape(message)) as refused:
        connect(url).status()
    assert "\n" not in str(refused.value)


def test_bus_that_is_not_there_is_a_bus_error() -> None:
    with pytest.raises(BusError, match="cannot open the CAN bus"):
        connect("canopen://socketcand/127.0.0.1:1/can0?node=5")


def test_can_addresses() -> None:
    assert bus_arguments("socketcand/host:29536/can1") == {
        "interface": "socketcand", "host": "host", "port": 29536, "channel": "can1",
    }  # fmt: skip
    assert bus_arguments("udp_multicast/239.74.163.2:5000") == {
        "interface": "udp_multicast", "channel": "239.74.163.2", "port": 5000,
    }  # fmt: skip
    assert bus_arguments("virtual/x") == {"interface": "virtual", "channel": "x"}
