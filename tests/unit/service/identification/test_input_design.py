"""Powers of a multisine's lines: what they tell is what a fit finds, and no others tell more within the limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from service.identification.input_design import LineInformation, best_powers, closed_loop, line_information
from service.identification.joint.refine import refine
from service.identification.joint.residuals import Weights
from service.identification.joint.uncertainty import uncertainty_of
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import Posterior, Split, log_ratios
from service.identification.statistics.whitening import whitener
from service.identification.synthetic import closed_loop_points
from sim.reference import reference_datasheet, reference_rig
from tests.support.planes import plane_model_of, relative_std, synthetic_experiment, synthetic_sweep

SHEET = reference_datasheet()
CONTROLLER = (np.array(SHEET.numerator), np.array(SHEET.denominator))
HZ = np.array([11.0, 23, 41, 59, 79, 151, 301, 489, 491, 493, 495, 633, 801, 905, 907, 909, 921, 999])
OMEGA = 2 * np.pi * HZ
CURRENT, DISPLACEMENT = 4e-5, 4e-10


@pytest.fixture(scope="module")
def model() -> PlaneModel:
    return plane_model_of(reference_rig(), "x")


@pytest.fixture(scope="module")
def told(model: PlaneModel) -> LineInformation:
    variance = np.tile(np.array([CURRENT, CURRENT, DISPLACEMENT, DISPLACEMENT]) ** 2, (len(HZ), 1))
    return line_information(model, CONTROLLER, OMEGA, variance, 2 * np.pi * 1000)


@pytest.fixture(scope="module")
def use(model: PlaneModel) -> np.ndarray:
    loop = closed_loop(model, CONTROLLER, OMEGA)
    return np.concatenate([np.abs(loop.y) ** 2 / 8e-6**2, np.abs(loop.i) ** 2 / 0.2**2], axis=1)


def test_the_closed_loop_is_that_of_a_small_experiment(model: PlaneModel) -> None:
    loop = closed_loop(model, CONTROLLER, OMEGA)
    for axis in range(2):
        u, i, y = closed_loop_points(model, CONTROLLER, OMEGA, np.full(len(OMEGA), axis), np.full(len(OMEGA), 1e-4))
        for mine, other in ((loop.u, u), (loop.i, i), (loop.y, y)):
            assert np.allclose(1e-4 * mine[:, :, axis], other, rtol=1e-4, atol=1e-4 * np.abs(other).max())


def test_the_bound_is_the_deviation_of_a_fit_that_knows_the_noise(model: PlaneModel, told: LineInformation) -> None:
    amplitude = 0.002
    both = dict.fromkeys("xy", model)
    sweep = synthetic_sweep(
        both, SHEET.axes, CONTROLLER, HZ, amplitude, current_noise_a=1e-9, displacement_noise_m=1e-14, seed=1
    )
    data = Data(plane_points(synthetic_experiment(sweep, axes=SHEET.axes).main, SHEET.axes, "x"))
    covariance = np.diag(np.array([CURRENT, CURRENT, DISPLACEMENT, DISPLACEMENT]) ** 2).astype(complex)
    weights = Weights(whitener(np.tile(covariance, (len(data.plant.omega), 1, 1))), None)
    ratios = log_ratios(model)
    fit = refine(model, data, model.layout.free(), weights=weights, split=Split(ratios), max_iterations=1)
    held = uncertainty_of(fit, Posterior(ratios, np.zeros((2, 2))))

    def figures(m: PlaneModel) -> np.ndarray:
        return np.log(np.concatenate([m.ki, m.ks, m.damping_ratios]))

    of_fit = held.std(model, figures)[1]
    of_lines = relative_std(told, np.full((len(HZ), 2), amplitude**2))
    assert np.allclose(of_lines, of_fit, rtol=0.02)


def test_no_powers_within_the_limits_tell_more(told: LineInformation, use: np.ndarray) -> None:
    """A general optimiser, from the powers and from equal ones, finds no better."""
    power = best_powers([told], use)
    assert np.einsum("lsj,lj->s", use, power).max() == pytest.approx(1.0)

    def value(logs: np.ndarray) -> float:
        p = np.exp(logs).reshape(power.shape)
        return float(np.sum(np.log(relative_std(told, p / np.einsum("lsj,lj->s", use, p).max()))))

    best = value(np.log(power).ravel())
    equal = np.zeros(power.size)
    assert best < value(equal) - 1.0
    for start in (np.log(np.maximum(power, 1e-6)).ravel(), equal):
        found = minimize(value, start, method="L-BFGS-B", bounds=[(-14, 3)] * power.size, options={"maxiter": 60})
        assert best < found.fun + 2e-3


def test_powers_for_several_models_forgive_a_peak_that_was_misplaced(model: PlaneModel, use: np.ndarray) -> None:
    variance = np.tile(np.array([CURRENT, CURRENT, DISPLACEMENT, DISPLACEMENT]) ** 2, (len(HZ), 1))

    def beside(shift: float) -> LineInformation:
        theta = model.theta.copy()
        for k in range(model.layout.n_modes):
            theta[model.layout.mode(k).start] += shift
        return line_information(model.at(theta), CONTROLLER, OMEGA, variance, 2 * np.pi * 1000)

    sides = [beside(0.0), beside(10.0), beside(-10.0)]
    alone, together = best_powers(sides[:1], use), best_powers(sides, use)
    mean = [np.mean([np.log(relative_std(s, p)) for s in sides]) for p in (alone, together)]
    assert mean[1] < mean[0] - 0.02
    assert np.all(relative_std(sides[0], together) < 2 * relative_std(sides[0], alone))
