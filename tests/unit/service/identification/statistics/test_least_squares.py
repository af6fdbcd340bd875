"""The minimiser."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.statistics.least_squares import covariance_of, minimise


def rosenbrock(theta, gradient):
    a, b = theta[:2]
    return np.array([10 * (b - a * a), 1 - a]), np.array([[-20 * a, 10, 0], [-1, 0, 0]]) if gradient else None


def test_a_curved_valley_is_followed_to_its_end() -> None:
    fit = minimise(rosenbrock, np.array([-1.2, 1.0, 5.0]), np.array([True, True, False]), 200, 1e-12)
    assert fit.converged
    assert np.allclose(fit.theta, [1, 1, 5], atol=1e-4)
    assert fit.status.startswith("converged")


def test_running_out_of_steps_is_a_status() -> None:
    fit = minimise(rosenbrock, np.array([-1.2, 1.0, 5.0]), np.array([True, True, False]), 3, 1e-12)
    assert not fit.converged
    assert fit.status == "iteration limit reached"
    (doubt,) = fit.doubt
    assert "did not end (iteration limit reached)" in doubt


def test_of_a_search_that_ended_there_is_no_doubt() -> None:
    assert minimise(rosenbrock, np.array([1.0, 1.0, 5.0]), np.array([True, True, False]), 200, 1e-12).doubt == ()


def test_steps_out_of_range_are_shortened() -> None:
    def log(theta, gradient):
        return None if theta[0] <= 0 else (np.log(theta) - 1.0, np.array([[1 / theta[0]]]))

    assert minimise(log, np.array([50.0]), np.array([True]), 100, 1e-12).theta[0] == pytest.approx(np.e, rel=1e-5)
    with pytest.raises(ValueError, match="physical range"):
        minimise(log, np.array([-1.0]), np.array([True]))


def test_covariance_has_huge_variance_where_the_data_are_blind() -> None:
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [3.0, 3.0, 5.0]])
    covariance = covariance_of(jacobian)
    assert covariance[0, 0] > 1e10
    assert covariance[2, 2] < 1.0
    seen = covariance_of(jacobian[:, 1:])
    assert np.allclose(seen, np.linalg.inv(jacobian[:, 1:].T @ jacobian[:, 1:]))


def test_columns_that_are_nearly_one_direction_are_told_apart() -> None:
    """Their products tell nothing of 1e-8; reflections do."""
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(40, 3))
    matrix[:, 2] = matrix[:, 1] + 1e-8 * rng.normal(size=40)
    truth = np.array([1.0, 2.0, -3.0])

    def residual(theta, gradient):
        return matrix @ (theta - truth), matrix

    fit = minimise(residual, np.zeros(3), np.ones(3, dtype=bool), 200, 1e-30, damping=1e-25)
    np.testing.assert_allclose(fit.theta, truth, rtol=1e-5)


def test_a_jacobian_to_the_moving_parameters_alone_leads_to_the_same() -> None:
    free = np.array([True, True, False])

    def narrow(theta, gradient):
        r, j = rosenbrock(theta, gradient)
        return r, j[:, free]

    wide, same = (minimise(f, np.array([-1.2, 1.0, 5.0]), free, 200, 1e-12) for f in (rosenbrock, narrow))
    np.testing.assert_array_equal(wide.theta, same.theta)


def test_a_last_step_that_changes_nothing_but_digits_is_taken_without_asking_again() -> None:
    calls = []

    def curved(theta, gradient):
        calls.append(1)
        return np.array([theta[0] ** 2 - 4.0]), np.array([[2 * theta[0]]])

    def minimised(start, physical):
        return minimise(curved, np.array([start]), np.array([True]), tolerance=0.01, physical=physical)

    near = minimised(2.0005, lambda theta: True)
    assert near.converged
    assert len(calls) == 1
    assert near.theta[0] == pytest.approx(2.0, abs=1e-6)
    assert near.residual[0] == pytest.approx(0.0, abs=1e-5)
    for start, physical in ((2.02, lambda theta: True), (2.0005, lambda theta: theta[0] > 2.0001), (2.0005, None)):
        calls.clear()
        assert minimised(start, physical).converged
        assert len(calls) > 1  # one per cent of a parameter, or a step to where the residuals may tell of no model
