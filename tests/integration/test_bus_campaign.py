"""An experiment over a bus is the experiment in process: same rig, assert_same seed, same points, same figures.

What is identified from it is a function of these figures alone (`benchmarks/buses.py agreement` identifies them).
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.controller import Capabilities, Controller, Tone, TripCause
from drivers.device.faults import KINDS
from drivers.device.machine import RigDevice
from drivers.device.play import Interruption
from drivers.device.serve import CanOptions, ModbusOptions, Served, serve_canopen, serve_modbus
from drivers.errors import BusError
from drivers.modbus.driver import tcp_links
from drivers.remote import RemoteController
from drivers.simulated.driver import SimulatedController
from drivers.url import connect
from service.campaign.aims import Profile
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from sim.reference import reference_datasheet, reference_rig

SEED = 7
FAULTS = ",".join(f"{kind}=0.0002" for kind in KINDS if kind not in ("corrupt", "stale")) + ",corrupt=1e-5,stale=1e-5"
"""Wrong values are rarer than lost ones: a raw record has thousands of frames, and one CRC."""
SMALL = Profile(accuracy=0.005, points=12, validation_points=2, amplifier_points=2, coarse_points=8, rig_seconds=40.0)


def campaign(controller: Controller, folder: Path) -> Experiment:
    return run_campaign(controller, reference_datasheet(), folder, profile=SMALL)


def assert_same(one: Experiment, two: Experiment) -> None:
    assert len(one.main.frequency_hz) > 40
    for a, b in zip(one.sweeps, two.sweeps, strict=True):
        for name in ("frequency_hz", "axis", "amplitude_a", "R", "U", "I", "Y"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.fixture(scope="module")
def in_process(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return campaign(SimulatedController(reference_rig(), SEED), tmp_path_factory.mktemp("in-process"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "serve",
    [
        lambda device: serve_modbus(device, ModbusOptions(port=0)),
        lambda device: serve_modbus(device, ModbusOptions(port=0, faults=FAULTS, fault_seed=2)),
    ],
    ids=["modbus", "modbus that fails"],
)
def test_experiment_over_a_bus_equals_the_one_in_process(
    serve: Callable[[RigDevice], Served], in_process: Experiment, tmp_path: Path
) -> None:
    served = serve(RigDevice(reference_rig(), SEED))
    controller = connect(served.url)
    try:
        assert_same(campaign(controller, tmp_path), in_process)
    finally:
        controller.close()
        served.close()


class Terse(RigDevice):
    """A device without raw records, which take their time on CAN; the contract suite compares them."""

    def capabilities(self) -> Capabilities:
        return replace(super().capabilities(), raw_records=False)


@pytest.mark.slow
def test_experiment_over_canopen_equals_the_one_in_process(tmp_path: Path) -> None:
    reference = campaign(SimulatedController(Terse(reference_rig(), SEED)), tmp_path / "in process")
    served = serve_canopen(Terse(reference_rig(), SEED), CanOptions())
    controller = connect(served.url)
    try:
        assert_same(campaign(controller, tmp_path / "canopen"), reference)
    finally:
        controller.close()
        served.close()


class Inattentive(RigDevice):
    """A device whose host falls silent in the middle of a tone now and then, as it does on a busy machine."""

    silences = 0

    def _guard(self) -> Interruption | None:
        self._looks = getattr(self, "_looks", 0) + 1
        if self._looks % 97:
            return super()._guard()
        self.silences += 1
        return Interruption(TripCause.HOST, "no heartbeat of the host for 200 ms")


def test_experiment_whose_tones_were_cut_short_equals_one_without_a_break(
    in_process: Experiment, tmp_path: Path
) -> None:
    """A tone that is asked for again meets the same noise: load on a machine leaves no trace in a result."""
    device = Inattentive(reference_rig(), SEED)
    assert_same(campaign(SimulatedController(device), tmp_path), in_process)
    assert device.silences > 5


def test_tone_whose_result_was_lost_is_not_measured_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    device = RigDevice(reference_rig(), SEED)
    served = serve_modbus(device, ModbusOptions(port=0))
    controller = RemoteController(tcp_links("127.0.0.1", int(served.url.split(":")[2].split("?")[0])), patience_s=0.1)
    tone, other = (Tone(axis=axis, amplitude_a=0.1, periods=10, samples=1000, blocks=2) for axis in (0, 1))

    def lost(size: int) -> bytes:
        raise BusError("no answer within 0.3 s")

    try:
        with controller.lease("host"):
            with monkeypatch.context() as failing:
                failing.setattr(controller._dialogue.link, "lockin_payload", lost)
                with pytest.raises(BusError):
                    controller.measure(tone)
            assert controller.measure(tone).sequence == 1
            assert controller.measure(tone).sequence == 2  # asked for anew, it is measured anew
            assert controller.measure(other).sequence == 3
    finally:
        controller.close()
        served.close()
    assert sum(event.text.startswith("excitation on") for event in device.events()) == 3
