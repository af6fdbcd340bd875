"""Parity and stop bits of a serial line, in the URL and in the simulated device."""

from typing import Any

import pytest
import serial

from drivers.device.machine import RigDevice
from drivers.device.serve import RtuOptions, serve_modbus_rtu
from drivers.errors import AddressError, ControllerError
from drivers.modbus.driver import rtu_links
from drivers.modbus.framing import framing
from drivers.url import connect
from sim.reference import reference_rig


def _opened(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    told: dict[str, Any] = {}

    def port(*_: Any, **options: Any) -> None:
        told.update(options)
        raise serial.SerialException("no such port")

    monkeypatch.setattr(serial, "Serial", port)
    monkeypatch.setattr(serial, "serial_for_url", port)
    return told


@pytest.mark.parametrize(
    ("option", "parity", "stop_bits"),
    [("", "N", 1), ("&parity=E", "E", 1), ("&parity=O", "O", 1), ("&parity=N", "N", 2)],
)
def test_a_port_is_opened_as_the_url_says(
    monkeypatch: pytest.MonkeyPatch, option: str, parity: str, stop_bits: int
) -> None:
    told = _opened(monkeypatch)
    with pytest.raises(ControllerError, match="cannot open the serial port"):
        connect(f"modbus+rtu:///dev/ttyUSB0?baud=19200{option}")
    assert (told["baudrate"], told["parity"], told["stopbits"]) == (19200, parity, stop_bits)


def test_the_simulated_device_opens_its_port_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    told = _opened(monkeypatch)
    with pytest.raises(ControllerError, match="cannot open the serial port"):
        serve_modbus_rtu(RigDevice(reference_rig()), RtuOptions("/dev/ttyUSB1", parity="E"))
    assert (told["parity"], told["stopbits"]) == ("E", 1)
    with pytest.raises(ControllerError, match="a pseudo-terminal has no parity: give the serial port"):
        serve_modbus_rtu(RigDevice(reference_rig()), RtuOptions(parity="E"))


@pytest.mark.parametrize("wrong", ["e", "even", "", "M"])
def test_a_parity_that_no_line_has_is_refused(wrong: str) -> None:
    with pytest.raises(AddressError, match=f"parity is E, O, N or left out, not {wrong!r}"):
        connect(f"modbus+rtu:///dev/ttyUSB0?parity={wrong}")


def test_a_parity_bit_takes_its_time_on_the_line() -> None:
    plain, even = (rtu_links("/dev/x", 9600, frames=framing(p)).raw_bytes_per_s for p in ("", "E"))
    assert plain is not None
    assert even == pytest.approx(plain * 10 / 11)
