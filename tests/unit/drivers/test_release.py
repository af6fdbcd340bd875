"""A lease is given back, whatever the bus does to the word."""

from __future__ import annotations

import pytest

from drivers.device.front import DeviceFront
from drivers.device.machine import RigDevice
from drivers.device.serve import ModbusOptions, serve_modbus
from drivers.link import RefusedError
from drivers.objects import Refusal
from drivers.packing import Values
from drivers.url import connect
from sim.reference import reference_rig


@pytest.mark.parametrize("refusal", [Refusal.LIMIT, Refusal.LEASE], ids=["a flipped bit", "a gateway that is busy"])
def test_a_release_that_the_bus_has_spoilt_is_said_again(refusal: Refusal, monkeypatch: pytest.MonkeyPatch) -> None:
    """That is no refusal of the lease's end, for which the next host would wait."""
    write, spoilt = DeviceFront.write, ["release"]

    def written(front: DeviceFront, group: str, values: Values) -> None:
        if group in spoilt:
            spoilt.remove(group)
            raise RefusedError(refusal, "spoilt on the bus")
        write(front, group, values)

    monkeypatch.setattr(DeviceFront, "write", written)
    served = serve_modbus(RigDevice(reference_rig(), seed=1), ModbusOptions(port=0))
    controller = connect(served.url)
    try:
        with controller.lease("host", seconds=60.0):
            pass
        assert (spoilt, served.device.status().lease_holder) == ([], "")
    finally:
        controller.close()
        served.close()
