"""A small experiment on the reference rig, drawn from its own linear model in a moment."""

import numpy as np

from service.experiment.data import Experiment
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep


def small_experiment(planes: str = "xy") -> tuple[Experiment, Datasheet]:
    """Main, unseen and amplifier sweep with the datasheet that belongs to them."""
    datasheet = reference_datasheet()
    models = {plane: plane_model_of(reference_rig(), plane) for plane in "xy"}
    controller = (np.array(datasheet.numerator), np.array(datasheet.denominator))
    near = [493 + np.linspace(-6, 6, 7), 907.5 + np.linspace(-9, 9, 7)]
    hz = np.unique(np.concatenate([np.geomspace(10, 1000, 50), *near]))
    sweeps = [
        synthetic_sweep(models, datasheet.axes, controller, hz, 0.15, seed=1),
        synthetic_sweep(
            models, datasheet.axes, controller, np.geomspace(12, 950, 20), 0.1, seed=2, comment="validation"
        ),
        synthetic_sweep(
            models, datasheet.axes, controller, np.geomspace(20, 3000, 20), 0.1, seed=3, comment="amplifier"
        ),
    ]
    if planes == "x":
        sweeps = [s.select(s.axis < 2) for s in sweeps]
    return synthetic_experiment(*sweeps, axes=datasheet.axes, rig=datasheet.name), datasheet
