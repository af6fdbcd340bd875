"""Deviations against the scatter that they predict."""

import numpy as np
import pytest

from service.experiment.data import Sweep
from service.identification.joint.refine import refine
from service.identification.joint.residuals import Weights
from service.identification.joint.uncertainty import uncertainty_of
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.plane.prediction import Points
from service.identification.plane_fit import fit_plane
from service.identification.priors.split import Posterior, Split, log_ratios
from service.identification.statistics.whitening import whitener
from tests.support.planes import synthetic_sweep
from tests.support.ringing import AXES, CONTROLLER, HZ, TRUTH, sheet

NOISE = 0.01


def measured(seed: int) -> Sweep:
    noise = {"current_noise_a": 0.0, "displacement_noise_m": 0.0, "relative_noise": NOISE}
    return synthetic_sweep({"x": TRUTH}, AXES, CONTROLLER, HZ, 0.05, seed=seed, **noise)


def test_weights_that_six_blocks_tell_leave_deviations_as_large_as_the_scatter() -> None:
    """Taken as they are, they promise two per cent too much.

    What an estimate scatters more than one that is told the noise is seen in their difference on the same data.
    """
    free, split, runs = TRUTH.layout.free(), Split(log_ratios(TRUTH)), 60
    held = Posterior(split.log_ratios, np.zeros((2, 2)))
    away, reported, plain = [], [], []
    for seed in range(runs):
        data = Data(plane_points(measured(seed), AXES, "x"))
        p = TRUTH.predict(Points(data.plant.omega, data.plant.u))
        size = NOISE * np.abs(np.hstack([p.i, p.y]))
        exact = Weights(whitener(np.einsum("pc,cd->pcd", size**2, np.eye(4)).astype(complex)), None)
        told = refine(TRUTH, data, free, weights=exact, split=split, nonlinear=False)
        own = refine(told.model, data, free, split=split, nonlinear=False)
        away.append((own.model.theta - told.model.theta)[free])
        for out, on in ((reported, True), (plain, False)):
            out.append(np.diag(uncertainty_of(own, held, estimated_weights=on).from_data))
    bound = np.diag(uncertainty_of(told, held).from_data)
    scatter = bound + np.mean(np.square(away), axis=0)
    ratio, without = (float(np.median(np.sqrt(np.mean(x, axis=0) / scatter))) for x in (reported, plain))
    assert ratio == pytest.approx(1.0, abs=0.012)
    assert without < 0.987


def test_a_plane_reports_deviations_in_units_of_its_residuals() -> None:
    found = fit_plane(measured(4), None, None, AXES, "x", sheet())
    u = uncertainty_of(found.selected.refined, found.selected.splits)
    assert u.adequate
    assert u.scale > 1.01
    plane = found.result(sheet())
    for k, name in enumerate(("kiA", "kiB", "ksA", "ksB")):
        assert plane.stiffness[name].std_from_data == pytest.approx(u.scale * np.sqrt(u.from_data[k, k]), rel=1e-6)
