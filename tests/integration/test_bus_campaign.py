"""An experiment over a bus is the experiment in process: same rig, same seed, same points, same figures.

What is identified from it is a function of these figures alone.
"""

from pathlib import Path

import numpy as np
import pytest

from drivers.controller import Controller
from drivers.device.machine import RigDevice
from drivers.device.serve import (
    CanOptions,
    ModbusOptions,
    serve_canopen,
    serve_modbus,
)
from drivers.simulated.driver import SimulatedController
from drivers.url import connect
from service.bootstrap import quick_profile
from service.experiment.campaign import run_campaign
from service.experiment.data import Experiment
from sim.reference import reference_datasheet, reference_rig

SEED = 7


def _campaign(controller: Controller, folder: Path) -> Experiment:
    return run_campaign(controller, reference_datasheet(), folder, profile=quick_profile())


@pytest.fixture(scope="module")
def in_process(tmp_path_factory: pytest.TempPathFactory) -> Experiment:
    return _campaign(SimulatedController(reference_rig(), SEED), tmp_path_factory.mktemp("in-process"))


@pytest.mark.parametrize(
    "serve",
    [
        lambda device: serve_modbus(device, ModbusOptions(port=0)),
        lambda device: serve_canopen(device, CanOptions()),
    ],
    ids=["modbus", "canopen"],
)
def test_experiment_over_a_bus_equals_the_one_in_process(serve, in_process: Experiment, tmp_path: Path) -> None:
    served = serve(RigDevice(reference_rig(), SEED))
    controller = connect(served.url)
    try:
        experiment = _campaign(controller, tmp_path)
    finally:
        controller.close()
        served.close()
    assert len(experiment.main.frequency_hz) > 40
    for one, two in zip(experiment.sweeps, in_process.sweeps, strict=True):
        np.testing.assert_array_equal(one.frequency_hz, two.frequency_hz)
        np.testing.assert_array_equal(one.Y, two.Y)
        np.testing.assert_array_equal(one.I, two.I)
