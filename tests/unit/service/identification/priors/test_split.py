"""What is known of how a mode's shape splits between bearings and sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.identification.joint.finish import finished
from service.identification.joint.refine import FAR, Refined, amplitude_of, refine, residuals_following
from service.identification.joint.residuals import residuals, weights_of
from service.identification.measured.data import Data
from service.identification.measured.points import plane_points
from service.identification.plane.model import PlaneModel
from service.identification.priors.split import (
    Knowledge,
    Posterior,
    Split,
    knowledge_rows,
    likeliest,
    log_prior,
    log_ratios,
    moved_along_splits,
    split_rows,
)
from service.identification.priors.split_posterior import posterior
from service.identification.steps.start import with_modes, with_split
from tests.support.planes import synthetic_sweep

NONE = np.empty(0)
CLOSE = Knowledge(0.2, (True, True), NONE, NONE, 0.1)
OMEGA = 2 * np.pi * np.geomspace(10, 1000, 40)


@pytest.fixture(scope="module")
def data(experiment, datasheet) -> Data:
    return Data(plane_points(experiment.main, datasheet.axes, "x"))


@pytest.fixture(scope="module")
def quiet(truth, datasheet, controller) -> Data:
    """A tenth of the motion and of the noise."""
    sweep = synthetic_sweep(
        truth, datasheet.axes, controller, OMEGA / (2 * np.pi), 0.02, current_noise_a=1e-5, displacement_noise_m=1e-10
    )
    return Data(plane_points(sweep, datasheet.axes, "x"))


def of(data: Data, truth: dict[str, PlaneModel], knowledge: Knowledge, relative: float = 0.0) -> Posterior:
    """What a fit that began at even splits says of them."""
    even = with_split(truth["x"], np.zeros(2))
    free = even.layout.free()
    begun: Refined = refine(even, data, free, split=knowledge, relative=relative)
    known = finished(begun, data, free, knowledge)[1]
    assert known is not None
    return known


def test_a_split_hardly_changes_what_is_measured(truth: dict[str, PlaneModel]) -> None:
    g = truth["x"].response(OMEGA)
    other = with_split(truth["x"], log_ratios(truth["x"]) + 0.3)
    change = np.linalg.norm(other.response(OMEGA) - g) / np.linalg.norm(g)
    assert 1e-6 < change < 5e-3


def test_rows_hold_the_splits_and_have_exact_derivatives(truth: dict[str, PlaneModel]) -> None:
    model, split = truth["x"], Split(np.array([0.2, -0.1]))
    rows, jacobian = split_rows(model, split)
    assert np.allclose(rows, (log_ratios(model) - split.log_ratios) / 1e-3)
    for k in range(model.layout.size):
        step = np.zeros_like(model.theta)
        step[k] = 1e-6 * max(abs(model.theta[k]), 1e-9)
        up, down = (
            split_rows(model.at(model.theta + step), split)[0],
            split_rows(model.at(model.theta - step), split)[0],
        )
        assert np.allclose(jacobian[:, k], (up - down) / (2 * step[k]), rtol=1e-5, atol=1e-6 * np.abs(jacobian).max())
    assert np.allclose(split_rows(with_split(model, split.log_ratios), split)[0], 0, atol=1e-6)


def test_slopes_along_the_splits_hold_what_the_excess_at_the_bearings_does(
    data: Data, truth: dict[str, PlaneModel]
) -> None:
    """Along what keeps all else that is measured: a split with every other parameter refitted."""
    model, step = truth["x"], 1e-3
    weights, free = weights_of(model, data, None)[0], model.layout.free()
    whole = residuals_following(model, data, weights, free, FAR)[1]
    held = residuals(model, data, weights, amplitude_of(model, data.plant), free=free)[1]
    assert whole is not None
    assert held is not None
    for k in range(2):
        hold = split_rows(model, Split(log_ratios(model), 1e-6))[1][:, free]
        asked = np.concatenate([np.zeros(len(held)), 1e6 * (np.arange(2) == k)])
        scale = np.linalg.norm(held, axis=0)
        along = np.zeros_like(model.theta)
        along[free] = np.linalg.lstsq(np.vstack([held, hold]) / scale, asked, rcond=1e-14)[0] / scale
        ends = [model.at(moved_along_splits(model, s * step * along)) for s in (1, -1)]
        r_up, r_down = (residuals_following(m, data, weights, free, FAR, gradient=False)[0] for m in ends)
        change = (r_up - r_down) / (2 * step)
        assert np.linalg.norm(whole @ along[free] - change) < 0.1 * np.linalg.norm(held @ along[free] - change)


def test_a_step_along_the_splits_keeps_the_products_of_shapes(truth: dict[str, PlaneModel]) -> None:
    model = truth["x"]
    step = (with_split(model, log_ratios(model) + np.array([0.01, -0.02])).theta - model.theta) * 50
    after = model.at(moved_along_splits(model, step))
    assert np.allclose(log_ratios(after), log_ratios(model) + np.array([0.5, -1.0]), atol=0.03)
    was, now = (
        np.linalg.norm(m.modes[:, 2:4], axis=1) * np.linalg.norm(m.modes[:, 4:6], axis=1) for m in (model, after)
    )
    straight = model.at(model.theta + step).modes
    bent = np.linalg.norm(straight[:, 2:4], axis=1) * np.linalg.norm(straight[:, 4:6], axis=1)
    assert np.all(abs(now - was) < 0.1 * abs(bent - was))
    other = np.where(np.arange(len(step)) < model.layout.delay, 0.01 * model.theta, 0.0)
    assert np.array_equal(moved_along_splits(model, other), model.theta + other)


@pytest.mark.parametrize("closeness", [0.05, 0.3, None])
def test_rows_of_knowledge_are_its_log_density_and_have_exact_derivatives(
    truth: dict[str, PlaneModel], closeness: float | None
) -> None:
    w = truth["x"].natural_frequencies
    for knowledge in (
        Knowledge(closeness, (True, False), NONE, NONE, 0.1),
        Knowledge(closeness, (True, True), w[:1], np.array([0.3]), 0.05),
        Knowledge(closeness, (True, True), NONE, NONE, 0.1, end_rad_s=float(truth["x"].modes[1, 0]) - 1.0),
    ):
        for away in (-1.2, 0.1, 0.9):
            model = with_split(truth["x"], log_ratios(truth["x"]) + away)
            rows, jacobian = knowledge_rows(model, knowledge)
            density = log_prior(model, log_ratios(model)[None, :], knowledge).sum()
            assert -0.5 * rows @ rows == pytest.approx(density, rel=1e-9)
            for k in range(model.layout.size):
                step = np.zeros_like(model.theta)
                step[k] = 1e-6 * max(abs(model.theta[k]), 1e-9)
                up, down = (knowledge_rows(model.at(model.theta + d), knowledge)[0] for d in (step, -step))
                slope = (up - down) / (2 * step[k])
                assert np.allclose(jacobian[:, k], slope, rtol=1e-5, atol=1e-6 * np.abs(jacobian).max())


def test_the_likeliest_split_is_that_of_a_shape_that_changes_least(truth: dict[str, PlaneModel]) -> None:
    model = truth["x"]
    shapes = model.modes.copy()
    shapes[:, 4:6] = shapes[:, 2:4]  # bearing and sensor move alike
    alike = replace(model, theta=with_modes(model, shapes).theta)
    for away in (-0.8, 0.5):
        assert np.allclose(likeliest(with_split(alike, np.full(2, away)), CLOSE), 0.0, atol=0.05)


def test_data_hold_one_combination_for_two_modes(data: Data, quiet: Data, truth: dict[str, PlaneModel]) -> None:
    """Small motion tells of the position stiffness's work alone; where the force law bends the other one shows too."""
    anything = replace(CLOSE, closeness=None)
    std = [np.sqrt(np.linalg.eigvalsh(of(d, truth, anything).covariance)) for d in (quiet, data)]
    ignorant = np.sqrt(np.linalg.eigvalsh(of(quiet, truth, anything, relative=0.3).covariance))
    assert np.all(np.array(std)[:, 0] < 0.3 * ignorant[0])
    assert std[0][1] > 0.2 * ignorant[1]
    assert std[1][1] < 0.3 * std[0][1]


def test_what_loud_lines_tell_of_splits_holds(data: Data, truth: dict[str, PlaneModel]) -> None:
    found = of(data, truth, replace(CLOSE, closeness=None))
    away = found.log_ratios - log_ratios(truth["x"])
    assert away @ np.linalg.solve(found.covariance, away) < 9.2  # chi2 of two, 99 %


def test_closeness_finds_the_truth_of_a_rotor_whose_shape_changes_at_one_end_only(
    data: Data, truth: dict[str, PlaneModel]
) -> None:
    found = of(data, truth, CLOSE)
    assert np.allclose(found.log_ratios, log_ratios(truth["x"]), atol=0.15)
    std = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.log_ratios - log_ratios(truth["x"])) < 3 * std)


def test_the_datasheets_rotor_model_is_taken_at_its_tolerance(data: Data, truth: dict[str, PlaneModel]) -> None:
    w = truth["x"].natural_frequencies
    known = Knowledge(0.08, (True, True), 1.01 * w, log_ratios(truth["x"]), 0.05)
    found = of(data, truth, known, relative=0.3)
    assert np.allclose(found.log_ratios, log_ratios(truth["x"]), atol=0.02)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), 0.05, rtol=0.2)
    far = Knowledge(0.08, (True, True), 1.5 * w, log_ratios(truth["x"]) + 1.0, 0.05)
    assert not np.allclose(of(data, truth, far).log_ratios, far.log_ratios, atol=0.5)


@pytest.mark.parametrize("std", [1e-4, 1e-2, 0.2])
def test_knowledge_however_sharp_is_reproduced(data: Data, truth: dict[str, PlaneModel], std: float) -> None:
    w = truth["x"].natural_frequencies
    known = Knowledge(0.2, (True, True), w, np.array([0.4, -0.3]), std)
    found = of(data, truth, known, relative=0.3)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), std, rtol=0.25)
    assert np.allclose(found.log_ratios, [0.4, -0.3], atol=0.35 * std + 1e-6)


@pytest.mark.parametrize("thickness", [0.3, 0.03, 0.003])
def test_where_data_tell_a_sum_of_two_splits_only_what_is_left_is_knowledge(
    truth: dict[str, PlaneModel], thickness: float
) -> None:
    """However well they tell the sum: against a quadrature across the ridge and along it."""
    model = with_split(truth["x"], np.array([0.45, 0.0]))
    free = model.layout.free()
    places = np.flatnonzero(free)
    told = np.array([1.0, 1.4]) / thickness
    largest = [
        model.layout.mode(k).start + 2 + int(np.argmax(np.abs(m[2:6]))) for k, m in enumerate(model.modes)
    ]  # without these no other parameter mimics a change of split
    others = np.flatnonzero(~np.isin(places, largest))
    jacobian = np.zeros((len(others) + 1, len(places)))
    jacobian[np.arange(len(others)), others] = 1.0
    for k, place in enumerate(largest):
        sign = 0.5 if place < model.layout.mode(k).start + 4 else -0.5
        jacobian[-1, np.searchsorted(places, place)] = told[k] / (sign * model.theta[place])
    found = posterior(model, np.zeros(len(jacobian)), jacobian, free, CLOSE).covariance

    first = np.linspace(-6, 6, 2401)[:, None]  # ln a of the first mode
    second = (np.linspace(-6, 6, 121) - told[0] * np.expm1(first)) / told[1]  # a - 1 of the second
    inside = second > np.expm1(-6)
    logs = np.log1p(np.where(inside, second, 0.0))
    split = log_ratios(model) - np.stack([np.broadcast_to(first, logs.shape), logs], axis=-1).reshape(-1, 2)
    density = log_prior(model, split, CLOSE).sum(axis=1).reshape(logs.shape) - logs
    density -= 0.5 * (told[0] * np.expm1(first) + told[1] * second) ** 2
    weight = np.where(inside, np.exp(density - density[inside].max()), 0.0)
    weight /= weight.sum()
    exact = [np.sum(weight * np.expm1(first) ** 2), np.sum(weight * second**2)]
    assert np.allclose(np.sqrt(np.diag(found)), np.sqrt(exact), rtol=0.1)
