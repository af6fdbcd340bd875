"""Addresses of controllers: what is understood, and what is refused before anything is opened."""

import re
import ssl
from dataclasses import replace

import pytest

from drivers.address import understood
from drivers.canopen.bus import bus_arguments
from drivers.errors import AddressError, BusError, ControllerError
from drivers.modbus.driver import ModbusLinks, tcp_links, tls_links
from drivers.remote import RemoteController
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
        ("modbus://pump..plant:502?unit=1", "a part of the host 'pump..plant' is empty or longer than 63 letters"),
        (f"modbus://{'a' * 64}.plant", "is empty or longer than 63 letters"),
        (f"modbuss://{'a' * 64}", "is empty or longer than 63 letters"),
        ("modbuss://.plant", "a part of the host '.plant' is empty"),
        ("modbus://\N{SNOWMAN}.plant", "U+2603"),
        (f"canopen://socketcand/{'a' * 64}:29536/can0?node=5", "is empty or longer than 63 letters"),
        ("canopen://udp_multicast/a..b?node=5", "is empty or longer than 63 letters"),
        ("modbus://host:0", "has the port 0; give 1 to 65535, or none for 502"),
        ("modbuss://host:0?unit=1", "has the port 0; give 1 to 65535, or none for 802"),
        ("canopen://socketcand/host:0/can0?node=5", "has the port 0; give 1 to 65535, or none for 29536"),
        ("canopen://socketcand/host:99999/can0?node=5", "has the port 99999; give 1 to 65535, or none for 29536"),
        ("modbus://ho\tst", "'modbus://ho\\tst' has a control character"),
        ("simulated://?seed=-1", "seed is 0 to"),
        ("canopen://pigeon/can0?node=1", "cannot read the CAN bus"),
        ("canopen://socketcan/?node=1", "cannot read the CAN bus"),
        ("modbuss://host?ca=/nowhere.pem", "certificates"),
        ("replay:///nowhere.jsonl", "cannot read the transcript"),
        ("modbus://host?map=/nowhere.toml", "cannot read the map"),
        ("simulated://?seed=many", "seed is a whole number"),
        ("modbus://host?unit=1_0", "unit is a whole number, not '1_0'"),
        ("modbus://host?unit=1&unit=2", "has the option unit more than once"),
        ("modbus://host/unit=3", "has the path '/unit=3'; options are behind a question mark, as ?unit=1"),
        ("modbuss://host:802#unit=3", "what is behind # means nothing here"),
        ("modbus://user:secret@host", "a modbus:// address holds no user or password"),
        ("modbus://ho st", "the host 'ho st' has a space"),
        ("canopen://socketcan/can0?node=5#6", "what is behind # means nothing here"),
        ("modbus+rtu://dev/ttyUSB0", "has a host 'dev'; write modbus+rtu:///dev/ttyUSB0"),
        ("simulated://rig.toml", "a datasheet is an option, write simulated://?rig=rig.toml"),
        ("simulated:///tmp/rig.toml?seed=1", "a datasheet is an option, write simulated://?rig=rig.toml"),
    ],
)
def test_wrong_url_is_refused_in_one_line(url: str, message: str) -> None:
    with pytest.raises(ControllerError, match=re.escape(message)) as refused:
        connect(url).status()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "url", ["modbus://a..b", "modbus://host:0", "canopen://socketcand/a..b/can0?node=5", "canopen://x?node=5"]
)
def test_an_address_that_cannot_be_is_bad_usage(url: str) -> None:
    with pytest.raises(AddressError):
        understood(url)


@pytest.mark.parametrize(
    "url",
    [
        "modbus://host.plant.:502",
        "modbus://[fe80::1%25lo]",
        "modbus://bücher.example",
        "modbus://xn--bcher-kva.example",
    ],
)
def test_a_host_that_a_network_may_know_is_let_pass(url: str) -> None:
    assert understood(url)[0].netloc == url.removeprefix("modbus://")


@pytest.mark.parametrize("links", [tcp_links("a..b", 502), tls_links("a..b", 802, ssl.create_default_context())])
def test_a_host_of_which_a_socket_makes_no_name_is_a_bus_error(links: ModbusLinks) -> None:
    """Whoever gave it, and however it got past what is checked before."""
    with pytest.raises(BusError, match="cannot connect: "):
        RemoteController(links)


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
