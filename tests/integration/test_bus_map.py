"""A vendor's own registers: the same driver, by a map from a file; and the parts of one bus that the others lack."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient

from drivers.controller import Controller, State, Tone
from drivers.device.front import DeviceFront
from drivers.device.machine import RigDevice
from drivers.device.modbus import TcpServer
from drivers.device.serve import ModbusOptions, RtuOptions, serve_modbus, serve_modbus_rtu, serve_modbus_tls
from drivers.errors import BusError, ControllerError
from drivers.modbus.map import parse_map
from drivers.packing import Value
from drivers.url import connect
from sim.reference import reference_rig
from tests.support.certificates import make_authority
from tests.support.vendor import assert_works_like_our_own

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
VENDOR = """
word_order = "little"
lockin_address = 2000
raw_address = 12000
[objects."identity.crc"]
absent = true
[objects."identity.identity"]
absent = true
[objects."identity.max_amplitude_a"]
address = 40000
type = "U16"
per_unit = 1000
[objects."status.crc"]
absent = true
[objects."status.snapshot"]
absent = true
[objects."status.lease_holder"]
absent = true
[objects."status.state"]
address = 41000
[objects."tone.crc"]
absent = true
[objects."tone.amplitude_a"]
address = 42000
type = "U16"
per_unit = 10000
"""


@pytest.fixture
def vendor_map(tmp_path: Path) -> Path:
    path = tmp_path / "vendor.toml"
    path.write_text(VENDOR)
    return path


def test_vendors_registers_work_like_our_own(vendor_map: Path) -> None:
    served = serve_modbus(RigDevice(reference_rig(), 3), ModbusOptions(port=0, map=vendor_map))
    controller = connect(f"{served.url}&map={vendor_map}")
    try:
        assert_works_like_our_own(controller, TONE, raw_samples=4500)
    finally:
        controller.close()
        served.close()


def test_wrong_map_finds_no_controller(vendor_map: Path) -> None:
    served = serve_modbus(RigDevice(reference_rig()), ModbusOptions(port=0, map=vendor_map))
    try:
        with pytest.raises(BusError, match="modbus://"):
            connect(served.url)
    finally:
        served.close()


def test_registers_answer_any_modbus_client() -> None:
    """pymodbus alone, without our driver: what a vendor's tool would see."""
    rig = RigDevice(reference_rig())
    served = serve_modbus(rig, ModbusOptions(port=0, unit=3))
    client = ModbusTcpClient("127.0.0.1", port=int(served.url.split(":")[2].split("?")[0]), timeout=1, retries=0)
    try:
        assert client.connect()
        axes = client.read_holding_registers(28, count=12, device_id=3)
        assert b"".join(r.to_bytes(2, "big") for r in axes.registers).rstrip(b"\0") == b"xA xB yA yB"
        assert client.read_holding_registers(260, count=1, device_id=3).registers == [State.LEVITATED]
        for request, code in (
            (lambda: client.read_holding_registers(900, count=2, device_id=3), 2),  # nothing there
            (lambda: client.read_input_registers(0, count=2, device_id=3), 2),  # no result yet
            (lambda: client.write_register(256, 1, device_id=3), 2),  # half an object, and read-only
            (lambda: client.write_registers(0x900, [0] * 17, device_id=3), 3),  # a command with a wrong CRC
            (lambda: client.read_coils(0, count=1, device_id=3), 1),  # no such function
            (lambda: client.read_holding_registers(0, count=1, device_id=9), 11),  # no such unit
        ):
            answer = request()
            assert answer.isError()
            assert answer.exception_code == code
        assert rig.rig_time_s == 0
        assert not client.write_registers(0x700, [0, 0], device_id=3).isError()  # stop, with nobody's token
    finally:
        client.close()
        served.close()


def test_raw_record_of_several_segments_is_put_together() -> None:
    served = serve_modbus(RigDevice(reference_rig(), 4), ModbusOptions(port=0))
    controller = connect(served.url)
    try:
        with controller.lease("host"):
            point = controller.measure(Tone(axis=0, amplitude_a=0.02, periods=9, samples=3000, blocks=2, raw=True))
        assert point.records is not None
        y = point.records["y"].reshape(2, 3000, 4)
        kernel = 2 / 3000 * np.exp(-2j * np.pi * 9 * np.arange(3000) / 3000)
        np.testing.assert_allclose(np.einsum("k,bkn->bn", kernel, y), point.Y[:, 1], atol=5e-12)
    finally:
        controller.close()
        served.close()


def test_host_without_a_certificate_is_not_let_in(tmp_path: Path) -> None:
    made = make_authority(tmp_path)
    options = ModbusOptions(port=0, certificate=made.server.certificate, key=made.server.key, client_ca=made.ca)
    served = serve_modbus_tls(RigDevice(reference_rig()), options)
    try:
        with pytest.raises(BusError):
            connect(f"{served.url}&ca={made.ca}")
        with pytest.raises(BusError, match="certificate verify failed"):
            connect(f"{served.url}&cert={made.client.certificate}&key={made.client.key}")
    finally:
        served.close()


@pytest.mark.parametrize(
    ("serve", "options", "message"),
    [
        (serve_modbus_tls, ModbusOptions(port=0), "needs a certificate"),
        (serve_modbus_tls, ModbusOptions(port=0, certificate=Path("/nowhere.pem")), "cannot use the certificates"),
        (serve_modbus_rtu, RtuOptions(device="/dev/nowhere"), "cannot open the serial port /dev/nowhere"),
        (serve_modbus, ModbusOptions(host="203.0.113.1", port=0), "cannot listen on 203.0.113.1"),
    ],
)
def test_device_that_cannot_be_served_says_why(serve, options, message: str) -> None:
    with pytest.raises(ControllerError, match=message):
        serve(RigDevice(reference_rig()), options)


WITHOUT_CRC = "\n".join(f'[objects."{group}.crc"]\nabsent = true' for group in ("identity", "status", "trip", "result"))


class _Tells(DeviceFront):
    """A vendor's controller that tells one object otherwise than ours does."""

    def __init__(self, device: RigDevice, told: str, value: Value) -> None:
        super().__init__(device, "big")
        self.group, self.name = told.split(".")
        self.value, self.from_now_on = value, False

    def read(self, group: str) -> dict[str, Value]:
        values = super().read(group)
        return values | {self.name: self.value} if self.from_now_on and group == self.group else values


@contextmanager
def telling(folder: Path, told: str, value: Value) -> Iterator[tuple[_Tells, Controller]]:
    """A controller over a vendor's map, and what stands behind it; it tells so from when that is asked of it."""
    (path := folder / "vendor.toml").write_text(WITHOUT_CRC)
    ours = parse_map(WITHOUT_CRC)
    theirs = replace(ours, entries=tuple(replace(e, obj=replace(e.obj, low=None, high=None)) for e in ours.entries))
    front = _Tells(RigDevice(reference_rig(), 3), told, value)
    server = TcpServer(front, registers=theirs)
    controller = connect(f"modbus://127.0.0.1:{server.port}?unit=1&map={path}")
    try:
        yield front, controller
    finally:
        controller.close()
        server.close()
        front.close()
        front.device.close()


@pytest.mark.parametrize(
    ("told", "value", "said"),
    [
        ("status.state", 9, "status.state as 9, and known are 0 off, 1 levitated, 2 armed"),
        ("status.trip", 7, "status.trip as 7, and known are 0 none, 1 host, 2 displacement, 3 current, 4 fault;"),
    ],
)
def test_a_code_that_a_vendor_has_added_is_told_with_its_object_and_those_that_are_known(
    tmp_path: Path, told: str, value: int, said: str
) -> None:
    with telling(tmp_path, told, value) as (front, controller):
        assert controller.status().state is State.LEVITATED
        front.from_now_on = True
        with pytest.raises(ControllerError, match=said) as refused:
            controller.status()
        assert not isinstance(refused.value, BusError), "asking again would not help"
        assert "in the map, or have the controller tell one of these" in str(refused.value)
        controller.stop()


def test_a_tone_that_ends_in_no_way_that_is_known_leaves_the_rotor_unexcited(tmp_path: Path) -> None:
    with telling(tmp_path, "status.outcome", 12) as (front, controller):
        with controller.lease("host"):
            front.from_now_on = True
            with pytest.raises(ControllerError, match=r"status\.outcome as 12, and known are 0 under way, 1 done, "):
                controller.measure(TONE)
        assert front.device.status().excitation_a == 0
        assert front.device.status().lease_holder == ""


def test_a_point_whose_peak_is_no_number_is_a_point(tmp_path: Path) -> None:
    with telling(tmp_path, "result.peak_displacement_m", float("nan")) as (front, controller):
        front.from_now_on = True
        with controller.lease("host"):
            point = controller.measure(TONE)
    assert np.isnan(point.peak_displacement_m)
    assert np.abs(point.Y[:, 1, 1]).min() > 1e-7


def test_counts_of_a_map_begin_anew_beyond_what_their_type_holds(tmp_path: Path) -> None:
    """16 bits are some twenty minutes of statuses, and eighteen hours of seconds."""
    (path := tmp_path / "vendor.toml").write_text(
        '[objects."status.crc"]\nabsent = true\n[objects."status.snapshot"]\ntype = "U16"\n'
        '[objects."status.uptime_s"]\ntype = "U16"\nper_unit = 1\n'
    )
    now = 0.0
    device = RigDevice(reference_rig(), 3, clock=lambda: now)
    device._snapshot = 65530
    served = serve_modbus(device, ModbusOptions(port=0, map=path))
    controller = connect(f"{served.url}&map={path}")
    try:
        now = 65540.0
        assert [controller.status().uptime_s for _ in range(12)] == [4.0] * 12
    finally:
        controller.close()
        served.close()
