"""A node that boots pre-operational, as CiA 301 has it: who leases it starts it, and leaves the others alone."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from drivers.canopen.bus import open_network
from drivers.controller import Controller, Tone
from drivers.device.machine import RigDevice
from drivers.device.serve import CanOptions, Served, serve_canopen
from drivers.errors import ControllerError
from drivers.url import connect
from sim.reference import reference_rig

TONE = Tone(axis=1, amplitude_a=0.1, periods=100, samples=10000, blocks=1)
"""A second on the rig, five times what its watchdog waits."""


@contextmanager
def node(name: str, self_starting: bool = False) -> Iterator[tuple[Served, Controller, list[bytes]]]:
    """A node on a bus of its own, a host, and the commands of network management that pass."""
    said: list[bytes] = []
    options = CanOptions(bus=f"virtual/{name}", self_starting=self_starting)
    served = serve_canopen(RigDevice(reference_rig(), seed=1, real_time=True), options)
    network = open_network(f"virtual/{name}")
    network.subscribe(0, lambda cob_id, data, timestamp: said.append(bytes(data)))
    controller = connect(served.url)
    try:
        yield served, controller, said
    finally:
        controller.close()
        network.disconnect()
        served.close()


def until(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not what() and time.monotonic() < end:
        time.sleep(0.01)
    assert what()


def test_a_node_that_waits_is_started_by_who_leases_it_and_no_other_one() -> None:
    with node("waits") as (_, controller, said):
        time.sleep(1.0)
        controller.status()
        assert said == [], "who only looks starts nothing"
        with controller.lease("host"):
            until(lambda: bool(said))
            assert controller.measure(TONE).tone == TONE
        assert said == [bytes([1, 5])]


def test_a_stop_reaches_a_node_that_was_started() -> None:
    with node("stops") as (served, controller, said), controller.lease("host"):
        until(lambda: bool(said))
        controller.stop()
        until(lambda: any(event.text == "stop" for event in served.device.events()))


def test_a_node_that_somebody_took_out_of_operation_is_not_started_again_under_that_lease() -> None:
    with node("taken") as (_, controller, said):
        with controller.lease("host"):
            until(lambda: bool(said))
            controller.measure(TONE)
            network = open_network("virtual/taken")
            network.send_message(0, [0x80, 5])
            with pytest.raises(ControllerError):
                controller.measure(TONE)
            time.sleep(1.0)
            assert said == [bytes([1, 5]), bytes([0x80, 5])]
            network.disconnect()
        with controller.lease("host"):
            until(lambda: said[-1] == bytes([1, 5]))


def test_a_node_that_starts_itself_is_told_nothing() -> None:
    with node("starts itself", self_starting=True) as (_, controller, said), controller.lease("host"):
        controller.measure(TONE)
        assert said == []
