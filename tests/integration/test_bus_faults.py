"""A bus that fails in every way: no wrong value is accepted, none is lost without a mark, the run ends by itself."""

import os
import re
import tty
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.controller import Controller, PointResult, State, Tone
from drivers.device.canopen import CanopenNode
from drivers.device.faults import KINDS, CanSpoiler, Dice, FaultPlan, ModbusSpoiler
from drivers.device.front import DeviceFront
from drivers.device.hub import CanHub
from drivers.device.machine import RigDevice
from drivers.device.modbus import RtuServer, TcpServer
from drivers.device.serve import ModbusOptions, serve_modbus_tls
from drivers.errors import BusError, ControllerError, LeaseError, TripError
from drivers.url import connect
from sim.reference import reference_rig
from tests.support.certificates import make_authority

POINTS = 60


class Witness(RigDevice):
    """A device that remembers every result it ever made."""

    def __init__(self, seed: int) -> None:
        super().__init__(reference_rig(), seed)
        self.truth: dict[int, PointResult] = {}

    def arm(self, tone: Tone, token: int) -> Callable[[], PointResult]:
        play = super().arm(tone, token)

        def remembered() -> PointResult:
            point = play()
            self.truth[point.sequence] = point
            return point

        return remembered


@contextmanager
def faulty_modbus(device: RigDevice, plan: FaultPlan) -> Iterator[tuple[str, Dice]]:
    spoiler = ModbusSpoiler(plan)
    server = TcpServer(DeviceFront(device, "big"), spoiler=spoiler)
    try:
        yield f"modbus://127.0.0.1:{server.port}", spoiler.dice
    finally:
        server.close()


@contextmanager
def faulty_modbus_rtu(device: RigDevice, plan: FaultPlan) -> Iterator[tuple[str, Dice]]:
    spoiler = ModbusSpoiler(plan)
    master, slave = os.openpty()
    tty.setraw(slave)
    server = RtuServer(DeviceFront(device, "big"), master, spoiler=spoiler)
    try:
        yield f"modbus+rtu://{os.ttyname(slave)}", spoiler.dice
    finally:
        server.close()
        os.close(master)
        os.close(slave)


@contextmanager
def faulty_canopen(device: RigDevice, plan: FaultPlan) -> Iterator[tuple[str, Dice]]:
    with ExitStack() as stack:
        spoiler = CanSpoiler(plan)
        hub = CanHub(spoil=spoiler)
        stack.callback(hub.close)
        address = f"socketcand/127.0.0.1:{hub.port}/can0"
        node = CanopenNode(DeviceFront(device, "little"), address, 5)
        stack.callback(node.close)
        yield f"canopen://{address}?node=5", spoiler.dice


def run_points(controller: Controller, tones: list[Tone]) -> tuple[list[PointResult], Counter[str]]:
    """Every tone until it succeeds, as a campaign does; every failure is marked."""
    results: list[PointResult] = []
    marks: Counter[str] = Counter()
    while len(results) < len(tones):
        assert sum(marks.values()) < 20 * len(tones), f"the run does not end: {marks}"
        try:
            with controller.lease("campaign", seconds=1.0):
                if controller.status().state is State.TRIPPED:
                    controller.acknowledge()
                while len(results) < len(tones):
                    results.append(controller.measure(tones[len(results)]))
        except (BusError, TripError, LeaseError, ControllerError) as error:
            marks[type(error).__name__] += 1
    return results, marks


def assert_survived(device: Witness, tones: list[Tone], results: list[PointResult]) -> None:
    for tone, point in zip(tones, results, strict=True):
        truth = device.truth[point.sequence]
        assert point.tone == tone
        # the wire, and the controller, have whole microamperes
        assert replace(tone, amplitude_a=0) == replace(truth.tone, amplitude_a=0)
        assert abs(tone.amplitude_a - truth.tone.amplitude_a) < 0.51e-6
        np.testing.assert_allclose(point.Y, truth.Y, rtol=1e-6, atol=1e-11)
        np.testing.assert_allclose(point.I, truth.I, rtol=1e-6, atol=2e-6)
        assert point.rig_seconds == truth.rig_seconds
    assert len({point.sequence for point in results}) == len(tones)
    leased = False
    for event in device.events():
        if re.match(r"leased", event.text):
            leased = True
        elif event.text == "lease released":
            leased = False
        elif event.text.startswith("excitation on"):
            assert leased, "excited without a lease"
    assert device.status().excitation_a == 0


def some_tones(count: int, seed: int) -> list[Tone]:
    generator = np.random.default_rng(seed)
    return [
        Tone(
            axis=int(generator.integers(4)),
            amplitude_a=float(generator.uniform(0.01, 0.05)),
            periods=int(generator.integers(1, 40)),
            samples=int(generator.integers(100, 400)),
            blocks=int(generator.integers(1, 4)),
        )
        for _ in range(count)
    ]


# A point takes some ten frames on Modbus, and some hundred on CAN.
@pytest.mark.parametrize(("bus", "rate"), [(faulty_modbus, 0.02), (faulty_modbus_rtu, 0.02), (faulty_canopen, 0.002)])
@pytest.mark.parametrize("kind", KINDS)
def test_each_fault_is_survived(bus, rate: float, kind: str) -> None:
    device = Witness(seed=3)
    tones = some_tones(12, seed=4)
    with bus(device, FaultPlan(1, {kind: rate})) as (url, dice):
        controller = connect_patiently(url)
        try:
            results, _ = run_points(controller, tones)
        finally:
            dice.on = False
            controller.close()
    assert_survived(device, tones, results)


@pytest.mark.parametrize(
    ("bus", "rate"), [(faulty_modbus, 0.002), (faulty_modbus_rtu, 0.002), (faulty_canopen, 0.0002)]
)
def test_all_faults_together_let_no_wrong_value_through(bus, rate: float) -> None:
    device = Witness(seed=5)
    tones = some_tones(POINTS, seed=6)
    with bus(device, FaultPlan(2, dict.fromkeys(KINDS, rate))) as (url, dice):
        controller = connect_patiently(url)
        try:
            results, _ = run_points(controller, tones)
        finally:
            dice.on = False
            controller.close()
        assert sum(dice.struck.values()) > 3
    assert_survived(device, tones, results)


# Five hundred frames on Modbus, nine thousand on CAN.
@pytest.mark.parametrize(("bus", "rate"), [(faulty_modbus, 0.01), (faulty_modbus_rtu, 0.01), (faulty_canopen, 0.0005)])
def test_a_long_record_comes_through_although_some_part_of_it_is_always_wrong(bus, rate: float) -> None:
    device = Witness(seed=9)
    tone = Tone(axis=0, amplitude_a=0.02, periods=10, samples=1280, blocks=1, raw=True)
    with bus(device, FaultPlan(3, {"corrupt": rate, "stale": rate})) as (url, dice):
        controller = connect_patiently(url)
        try:
            ([point], _) = run_points(controller, [tone])
        finally:
            dice.on = False
            controller.close()
        assert dice.struck["corrupt"] > 1
        assert dice.struck["stale"] > 1
    assert point.records is not None
    truth = device.truth[point.sequence].records
    assert truth is not None
    np.testing.assert_allclose(point.records["y"], truth["y"], rtol=1e-6)
    np.testing.assert_allclose(point.records["i"], truth["i"], rtol=1e-6)


def connect_patiently(url: str) -> Controller:
    for _ in range(20):
        try:
            return connect(url)
        except ControllerError:
            continue
    raise AssertionError("no connection in twenty attempts")


def test_unknown_fault_is_refused() -> None:
    with pytest.raises(ControllerError, match="no fault 'gremlins'"):
        FaultPlan.parse("gremlins=0.1", 1)
    with pytest.raises(ControllerError, match="probabilities"):
        FaultPlan.parse("drop=1.5", 1)
    assert set(FaultPlan.parse("all=0.01", 1).rates) == set(KINDS)


def test_faults_in_tls_are_survived(tmp_path: Path) -> None:
    """The spoiler sits inside the encryption, where there are frames."""
    device, made, tones = Witness(seed=7), make_authority(tmp_path), some_tones(20, seed=8)
    options = ModbusOptions(
        port=0, certificate=made.server.certificate, key=made.server.key, faults="all=0.003", fault_seed=3
    )
    served = serve_modbus_tls(device, options)
    controller = connect_patiently(f"{served.url}&ca={made.ca}")
    try:
        results, _ = run_points(controller, tones)
    finally:
        controller.close()
        served.close()
    assert_survived(device, tones, results)
