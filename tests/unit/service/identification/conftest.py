"""Experiments drawn from the reference rig's own model: the truth is known to every digit."""

from __future__ import annotations

import numpy as np
import pytest

from service.experiment.data import Experiment
from service.identification.fit import identify
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep

FREQUENCY_HZ = np.unique(
    np.concatenate([np.geomspace(10, 1000, 60), 493 + np.linspace(-6, 6, 7), 907.5 + np.linspace(-9, 9, 7)])
)


@pytest.fixture(scope="session")
def datasheet() -> Datasheet:
    return reference_datasheet()


@pytest.fixture(scope="session")
def truth() -> dict[str, PlaneModel]:
    return {plane: plane_model_of(reference_rig(), plane) for plane in "xy"}


@pytest.fixture(scope="session")
def controller(datasheet: Datasheet) -> tuple[np.ndarray, np.ndarray]:
    return np.array(datasheet.numerator), np.array(datasheet.denominator)


@pytest.fixture(scope="session")
def experiment(datasheet: Datasheet, truth: dict[str, PlaneModel], controller) -> Experiment:
    size = np.where(FREQUENCY_HZ < 100, 0.12, 0.2)
    main = synthetic_sweep(truth, datasheet.axes, controller, FREQUENCY_HZ, size, seed=1)
    unseen = synthetic_sweep(
        truth, datasheet.axes, controller, np.geomspace(12, 950, 20), 0.15, seed=2, comment="validation"
    )
    return synthetic_experiment(main, unseen, axes=datasheet.axes)


@pytest.fixture(scope="session")
def result(experiment: Experiment, datasheet: Datasheet) -> CommissioningResult:
    return identify(experiment, datasheet)
