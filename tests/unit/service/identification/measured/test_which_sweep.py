"""Whatever sweeps a file has, and in whatever order, the main one is fitted and what cannot check it costs nothing."""

from dataclasses import replace

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.identification.fit import identify
from sim.reference import reference_rig
from tests.support import commissioned
from tests.support.commissioned import LAW
from tests.support.planes import plane_model_of, synthetic_experiment, synthetic_sweep
from tests.support.two_axes import sheet_of_one_plane

pytestmark = pytest.mark.slow

SHEET = sheet_of_one_plane(commissioned.SHEET)  # sweeps are chosen for all planes alike
AXES = SHEET.axes
MODELS = {"x": plane_model_of(reference_rig(), "x")}
NOISE = {"relative_noise": 1e-3, "current_noise_a": 1e-6, "displacement_noise_m": 1e-12}


def swept(comment: str, count: int, seed: int) -> Sweep:
    near = [m[0] / (2 * np.pi) + np.linspace(-3, 3, 5) for model in MODELS.values() for m in model.modes]
    hz = np.unique(np.concatenate([np.geomspace(11 + seed, 980 - seed, count), *near]))
    return synthetic_sweep(MODELS, AXES, LAW, hz, 0.05, seed=seed, comment=comment, **NOISE)


def test_a_coarse_sweep_that_comes_first_is_not_the_one_that_is_fitted() -> None:
    sweeps = (swept("preliminary", 8, 1), swept("main", 40, 2))
    found = identify(synthetic_experiment(*sweeps, axes=AXES, rig="reference"), SHEET).document()
    assert found["provenance"]["main_sweep"] == "sweeps/1 (main)"


def test_a_sweep_of_single_blocks_is_no_check_and_no_end_of_the_identification() -> None:
    poor = swept("validation", 12, 3)
    poor = replace(poor, **{k: getattr(poor, k)[:, :1] for k in "RUIY"})
    found = identify(synthetic_experiment(swept("main", 40, 2), poor, axes=AXES, rig="reference"), SHEET)
    assert found.planes["x"].cross_validation_fit_percent is None
    assert any("cross-validation cannot be used" in warning for warning in found.warnings)
