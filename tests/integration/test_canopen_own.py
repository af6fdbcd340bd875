"""What only CANopen has: a vendor's own object dictionary, and a hub that goes away and comes back."""

import time
from pathlib import Path

import canopen
import pytest

from drivers.canopen.bus import open_network
from drivers.canopen.dictionary import eds
from drivers.canopen.driver import CanopenLinks
from drivers.canopen.map import SEGMENT_BYTES, read_map
from drivers.controller import State, Tone
from drivers.device.faults import CanSpoiler, FaultPlan
from drivers.device.hub import CanHub
from drivers.device.machine import RigDevice
from drivers.device.serve import CanOptions, serve_canopen
from drivers.errors import BusError, LimitError
from drivers.remote import RemoteController
from drivers.url import connect
from sim.reference import reference_rig
from tests.support.vendor import assert_works_like_our_own

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)
VENDOR = """
whole_groups = false
lockin_index = 0x5200
raw_index = 0x5201
beat_cob_id = 0x400
stop_cob_id = 0x480
progress_cob_id = 0x280
[objects."identity.crc"]
absent = true
[objects."identity.identity"]
absent = true
[objects."identity.max_amplitude_a"]
index = 0x3000
subindex = 0
type = "U16"
per_unit = 1000
[objects."status.crc"]
absent = true
[objects."status.lease_holder"]
absent = true
[objects."status.displacement_m"]
index = 0x3001
subindex = 1
per_unit = 10000000
[objects."trip.crc"]
absent = true
[objects."result.crc"]
absent = true
[objects."tone.crc"]
absent = true
[objects."tone.amplitude_a"]
index = 0x3002
subindex = 7
type = "U16"
per_unit = 10000
"""


@pytest.fixture
def vendor_map(tmp_path: Path) -> Path:
    path = tmp_path / "vendor.toml"
    path.write_text(VENDOR)
    return path


def test_vendors_objects_work_like_our_own(vendor_map: Path) -> None:
    served = serve_canopen(RigDevice(reference_rig(), 3), CanOptions(map=vendor_map))
    controller = connect(f"{served.url}&map={vendor_map}")
    try:
        assert_works_like_our_own(controller, TONE, raw_samples=500)
        with controller.lease("host"), pytest.raises(LimitError):
            controller.measure(Tone(axis=0, amplitude_a=7.0, periods=1, samples=500))
    finally:
        controller.close()
        served.close()


def test_wrong_map_finds_no_controller(vendor_map: Path) -> None:
    served = serve_canopen(RigDevice(reference_rig()), CanOptions(map=vendor_map))
    try:
        with pytest.raises(BusError, match="canopen://"):
            connect(served.url)
    finally:
        served.close()


def test_vendors_eds_is_all_that_another_tool_needs(vendor_map: Path, tmp_path: Path) -> None:
    """canopen alone, with the EDS file and without our driver."""
    file = tmp_path / "vendor.eds"
    file.write_text(eds(5, read_map(vendor_map)))
    served = serve_canopen(RigDevice(reference_rig()), CanOptions(map=vendor_map))
    network = open_network(served.url.removeprefix("canopen://").partition("?")[0])
    try:
        time.sleep(0.1)  # the hub lets nobody hear what passes while an interface is being opened
        node = canopen.RemoteNode(5, str(file))
        network.add_node(node)
        assert node.sdo["max_amplitude_a"].phys == pytest.approx(6.0)
        assert node.sdo["status"]["state"].raw == State.LEVITATED
        with pytest.raises(canopen.SdoAbortedError, match="0x08000022"):  # not the lease's holder
            node.sdo["acknowledge"]["token"].raw = 7
            node.sdo["acknowledge"]["crc"].raw = 0xBF204ABF
    finally:
        network.disconnect()
        served.close()


def test_hub_that_comes_back_is_used_again_by_device_and_host() -> None:
    hub = CanHub()
    address, port = f"socketcand/127.0.0.1:{hub.port}/can0", hub.port
    served = serve_canopen(RigDevice(reference_rig(), 2), CanOptions(bus=address))
    controller = connect(served.url)
    try:
        with controller.lease("host"):
            assert controller.measure(TONE).sequence == 1
            for sequence in (2, 3):
                hub.close()
                time.sleep(0.3)
                hub = CanHub(port=port)
                assert controller.measure(TONE).sequence == sequence
    finally:
        controller.close()
        served.close()
        hub.close()


def test_lost_frames_are_told_with_node_what_was_lost_and_what_to_see_to() -> None:
    spoiler = CanSpoiler(FaultPlan(1, {"drop": 0.35}))
    spoiler.dice.on = False
    hub = CanHub(spoil=spoiler)
    served = serve_canopen(RigDevice(reference_rig(), 2), CanOptions(bus=f"socketcand/127.0.0.1:{hub.port}/can0"))
    controller = RemoteController(canopen_links(served.url), patience_s=1.0)
    try:
        spoiler.dice.on = True
        told = r"node=5: the SDO transfer of object 0x2\d{3} \(.*\) with node 5 failed: .*frames are lost on the way "
        with pytest.raises(BusError, match=told + r"\(\d+ of \d+ transfers failed\): see to termination, wiring"):
            while True:
                controller.status()
    finally:
        spoiler.dice.on = False
        controller.close()
        served.close()
        hub.close()


def test_a_raw_record_that_was_given_up_goes_on_with_what_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus so bad that no try gets the whole of it gets it in several."""
    links = CanopenLinks("virtual/none", 5)
    link = links.link()
    record = bytes(range(256)) * 60
    asked: list[int] = []

    def segment(result: int, number: int, size: int) -> bytes:
        asked.append(number)
        if len(asked) % 3 == 0:
            raise BusError("lost")
        return record[number * SEGMENT_BYTES :][:size]

    monkeypatch.setattr("drivers.canopen.driver.SEGMENTS_S", 0.0)
    monkeypatch.setattr(link, "_block", lambda *asked: (_ for _ in ()).throw(BusError("the whole never comes")))
    monkeypatch.setattr(link, "_segment", segment)
    with pytest.raises(BusError):
        link.raw_record(7, len(record))
    with pytest.raises(BusError):
        link.raw_record(7, len(record))
    assert link.raw_record(7, len(record)) == record
    assert asked == [0, 1, 2, 2, 3, 4, 4]
    with pytest.raises(BusError):
        link.raw_record(8, len(record))
    assert asked[7:] == [0, 1], "another result's are asked for from the first"


def test_a_node_that_has_gone_is_not_taken_for_lost_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.canopen.driver.SILENT_S", 0.5)
    hub = CanHub()
    served = serve_canopen(RigDevice(reference_rig(), 2), CanOptions(bus=f"socketcand/127.0.0.1:{hub.port}/can0"))
    controller = RemoteController(canopen_links(served.url), patience_s=1.5)
    try:
        served.close()
        with pytest.raises(BusError, match=r"object 0x2\d{3} \(status\) with node 5 .*silent for .*still on"):
            controller.status()
    finally:
        controller.close()
        hub.close()


def test_a_node_that_has_other_objects_is_told_as_that(vendor_map: Path) -> None:
    served = serve_canopen(RigDevice(reference_rig()), CanOptions(map=vendor_map))
    try:
        with pytest.raises(BusError, match=r"node 5 refused object 0x.*0x0602.*does not exist.*name them with map="):
            connect(served.url)
    finally:
        served.close()


def canopen_links(url: str) -> CanopenLinks:
    return CanopenLinks(url.removeprefix("canopen://").partition("?")[0], 5)
