"""The rig ends with its excitation off, whatever happens to the host: seen from the device, on real processes."""

import json
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.controller import Controller, State, Tone, TripCause
from drivers.device.machine import RigDevice
from drivers.device.serve import ModbusOptions, serve_modbus
from drivers.errors import BusError, LeaseError, RestartError, TripError
from drivers.modbus.driver import tcp_links
from drivers.remote import RemoteController
from drivers.url import connect
from sim.reference import reference_rig
from tests.support.buses import PROTOCOLS
from tests.support.processes import Process, device, read_events, wait_for

TONE = Tone(axis=1, amplitude_a=0.1, periods=10, samples=1000, blocks=2)


@pytest.fixture(params=list(PROTOCOLS))
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Process, Path]]:
    process, events = device(tmp_path, "--real-time", *PROTOCOLS[request.param])
    yield process, events
    process.end()


def _first(events: Path, text: str) -> float | None:
    return next((float(str(e["monotonic_s"])) for e in read_events(events) if text in str(e["text"])), None)


def _play(url: str) -> Process:
    return Process("-m", "tests.support.host", url)


def test_killed_host_leaves_the_excitation_off_and_the_trip_latched(rig: tuple[Process, Path]) -> None:
    process, events = rig
    host = _play(process.said)
    try:
        wait_for(lambda: _first(events, "excitation on"), "excitation")
        time.sleep(0.3)
        killed = host.kill()
        wait_for(lambda: _first(events, "excitation off"), "excitation off")
        # it is the watchdog that ended it, and neither the end of the connection nor that of the tone
        tripped, off = (
            _first(events, "trip HOST: no heartbeat of the host for 200 ms"),
            _first(events, "excitation off"),
        )
        assert tripped is not None
        assert off is not None
        assert killed < tripped < off
    finally:
        host.end()
    successor = connect(process.said)
    try:
        status = successor.status()
        assert (status.state, status.trip, status.excitation_a) == (State.TRIPPED, TripCause.HOST, 0)
        assert "heartbeat" in status.trip_message
        # the dead host's lease runs out, and the next one finds the trip
        wait_for(lambda: successor.status().lease_holder == "", "end of the lease")
        with successor.lease("next"):
            with pytest.raises(TripError, match="latched"):
                successor.measure(TONE)
            successor.acknowledge()
            successor.measure(TONE)
    finally:
        successor.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGSTOP])
def test_interrupted_or_frozen_host_leaves_the_excitation_off(tmp_path: Path, number: int) -> None:
    process, events = device(tmp_path, "--real-time")
    watcher = connect(process.said)
    host = _play(process.said)
    try:
        wait_for(lambda: watcher.status().excitation_a > 0.04, "excitation")
        host.kill(number)
        wait_for(lambda: _first(events, "excitation off"), "excitation off")
        wait_for(lambda: watcher.status().lease_holder == "", "end of the lease")
        status = watcher.status()
        assert status.excitation_a == 0
        # Ctrl-C stops in order; a host that stands still is tripped
        assert status.trip is (TripCause.NONE if number == signal.SIGINT else TripCause.HOST)
    finally:
        host.end()
        watcher.close()
        process.end()


def test_terminated_device_ends_with_the_excitation_off(tmp_path: Path) -> None:
    process, events = device(tmp_path, "--real-time")
    watcher = connect(process.said)
    host = _play(process.said)
    try:
        wait_for(lambda: watcher.status().excitation_a > 0.04, "excitation")
        process.kill(signal.SIGTERM)
        assert process.wait() == 0
        assert _first(events, "excitation off") is not None
    finally:
        host.end()
        watcher.close()
        process.end()


def test_restarted_device_is_told_from_the_one_before(tmp_path: Path) -> None:
    process, _ = device(tmp_path)
    controller = connect(process.said)
    port = process.said.split(":")[2].split("?")[0]
    process_2 = None
    try:
        with controller.lease("host"):
            before = controller.measure(TONE)
            process.kill()
            process.wait()
            process_2, _ = device(tmp_path, "--port", port)
            with pytest.raises(RestartError, match="restarted"):
                controller.measure(TONE)
        with controller.lease("host"):
            after = controller.measure(TONE)
        assert (before.sequence, after.sequence) == (1, 1)
    finally:
        controller.close()
        process.end()
        if process_2:
            process_2.end()


def test_bus_that_comes_back_is_used_again(tmp_path: Path) -> None:
    """The device's server goes away for a second and returns; the call under way goes on."""
    rig = RigDevice(reference_rig())
    served = serve_modbus(rig, ModbusOptions(port=0))
    port = int(served.url.split(":")[2].split("?")[0])
    controller = connect(served.url)
    try:
        with controller.lease("host"):
            controller.measure(TONE)
            served.shut()
            time.sleep(0.3)
            served = serve_modbus(rig, ModbusOptions(port=port))
            assert controller.measure(TONE).sequence == 2
    finally:
        controller.close()
        served.close()


def test_dead_address_is_a_bus_error_that_names_it() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(BusError, match=f"modbus://127.0.0.1:{port}.unit=1: cannot connect: Connection refused; see"):
        RemoteController(tcp_links("127.0.0.1", port))


def test_lost_bus_ends_the_call_and_the_excitation(tmp_path: Path) -> None:
    process, _ = device(tmp_path, "--real-time")
    port = int(process.said.split(":")[2].split("?")[0])
    controller: Controller = RemoteController(tcp_links("127.0.0.1", port), patience_s=1.0)
    try:
        with controller.lease("host"):
            process.kill()
            with pytest.raises(BusError, match="modbus://"):
                controller.measure(TONE)
    finally:
        controller.close()
        process.end()


def test_write_outside_its_limits_is_refused_by_the_device_too(tmp_path: Path) -> None:
    """A host without our driver's checks: the raw registers."""
    from drivers.link import RefusedError
    from drivers.objects import Refusal

    rig = RigDevice(reference_rig())
    served = serve_modbus(rig, ModbusOptions(port=0))
    link = tcp_links("127.0.0.1", int(served.url.split(":")[2].split("?")[0])).link()
    tone = {
        "token": 7, "command": 1, "axis": 0, "amplitude_a": 0.1, "periods": 10, "samples": 1000,
        "blocks": 1, "settle_samples": 0, "raw": 0,
    }  # fmt: skip
    try:
        with pytest.raises(RefusedError) as refused:
            link.write("tone", tone)
        assert refused.value.refusal is Refusal.LEASE
        link.write("lease", {"token": 7, "seconds": 5.0, "holder": "raw"})
        for wrong in ({"amplitude_a": 7.0}, {"periods": 499}, {"samples": 3_000_000}):
            with pytest.raises(RefusedError) as refused:
                link.write("tone", tone | wrong)
            assert refused.value.refusal is Refusal.LIMIT
        assert rig.rig_time_s == 0
        with pytest.raises(RefusedError):
            link.write("lease", {"token": 8, "seconds": 5.0, "holder": "thief"})
        link.write("lease", {"token": 7, "seconds": 5.0, "holder": "raw"})  # asked again: harmless
    finally:
        link.close()
        served.close()


def test_second_host_is_refused_while_a_worker_that_was_killed_still_holds_the_lease(tmp_path: Path) -> None:
    process, _ = device(tmp_path)
    controller = connect(process.said)
    host = _play(process.said)
    try:
        wait_for(lambda: controller.status().lease_holder == "victim", "lease")
        with pytest.raises(LeaseError, match="'victim'") as refused, controller.lease("other"):
            pass
        assert 0 < refused.value.seconds_left <= 2.0
    finally:
        host.end()
        controller.close()
        process.end()


def test_events_are_json_lines(tmp_path: Path) -> None:
    process, events = device(tmp_path)
    process.end()
    first = json.loads(events.read_text().splitlines()[0])
    assert first["text"] == "levitated"
