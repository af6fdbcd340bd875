"""A commissioned rig in a second: its result from the frequency-domain model with noise, and short checks in time."""

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from drivers.simulated.driver import SimulatedController
from service.campaign.run import run_campaign
from service.experiment.data import Experiment
from service.health.tones import ShortPlan, short_plan
from service.identification.fit import identify
from service.identification.result.commissioning import CommissioningResult
from sim.datasheet import Datasheet
from sim.reference import reference_datasheet, reference_rig
from sim.rig import Rig
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep

AXES = ("xA", "xB", "yA", "yB")
SHEET: Datasheet = reference_datasheet()
LAW = (np.array(SHEET.numerator), np.array(SHEET.denominator))


@cache
def commissioned() -> CommissioningResult:
    """The reference rig identified, about as accurately as from a campaign."""
    models = {p: plane_model_of(reference_rig(), p) for p in "xy"}
    near = [m[0] / (2 * np.pi) + np.linspace(-3, 3, 7) for model in models.values() for m in model.modes]
    main = np.unique(np.concatenate([np.geomspace(10, 1000, 70), *near]))
    noise = {"relative_noise": 1e-3, "current_noise_a": 1e-6, "displacement_noise_m": 1e-12}
    sweeps = [
        synthetic_sweep(models, AXES, LAW, f, 0.05, seed=seed, comment=comment, **noise)
        for seed, (f, comment) in enumerate([(main, "main"), (np.geomspace(12, 990, 20), "validation")])
    ]
    return identify(synthetic_experiment(*sweeps, axes=AXES, rig="reference"), SHEET)


@cache
def result() -> dict:
    """result.json of it."""
    return commissioned().document()


@cache
def plan() -> ShortPlan:
    """The reference rig's health check."""
    return short_plan(SHEET, result(), 75.0)


def check(rig: Rig, seed: int = 1) -> Experiment:
    """The health check, run on a rig in time."""
    with tempfile.TemporaryDirectory() as folder:
        return run_campaign(SimulatedController(rig, seed), SHEET, Path(folder), profile=plan().profile)


def with_magnets(ki: float = 1.0, ks: float = 1.0, axes: slice | list[int] = slice(None)) -> Rig:
    """The reference rig with some of its magnets stronger or weaker."""
    rig = reference_rig()
    new_ki, new_ks = rig.magnets.ki.copy(), rig.magnets.ks.copy()
    new_ki[axes] *= ki
    new_ks[axes] *= ks
    return replace(rig, magnets=replace(rig.magnets, ki=new_ki, ks=new_ks))


def with_mode(place: int, frequency: float = 1.0, damping: float = 1.0) -> Rig:
    """The reference rig with one mode changed, in both planes."""
    rig = reference_rig()
    modes = tuple(
        tuple(
            replace(
                m,
                natural_frequency_rad_s=m.natural_frequency_rad_s * frequency,
                damping_ratio=m.damping_ratio * damping,
            )
            if k == place
            else m
            for k, m in enumerate(plane)
        )
        for plane in rig.rotor.modes
    )
    return replace(rig, rotor=replace(rig.rotor, modes=modes))
