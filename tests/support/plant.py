"""The plant of an experiment, explained from its main sweep alone."""

from __future__ import annotations

import numpy as np

from service.experiment.data import Experiment
from service.gap.fitting.candidates import Fitter
from service.gap.fitting.nuisance import nuisance
from service.gap.fitting.part import Ground, parts
from service.gap.measured.observation import observe
from service.gap.which.explained import Explained
from service.gap.which.search import LARGEST_MIXTURE, explain
from sim.datasheet import Datasheet


def plant_of(measured: Experiment, datasheet: Datasheet, most: int = LARGEST_MIXTURE) -> Explained:
    """Every explanation of it by up to ``most`` effects, the best first."""
    nu = nuisance(datasheet)
    o = observe(measured.sweeps[0], nu.rig)
    part = next(p for p in parts(nu, (o,)) if p.path == "plant")
    with Fitter() as fitter:
        return explain(fitter, Ground(nu, part, (o,), np.zeros(len(nu))), most=most)
