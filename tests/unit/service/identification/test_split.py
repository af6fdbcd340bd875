"""What is known of how a mode's shape splits between bearings and sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.identification.plane_model import PlaneModel
from service.identification.points import plane_points
from service.identification.refine import Data, refine
from service.identification.selection import with_split
from service.identification.split import Knowledge, Split, held_at_start, log_ratios, posterior, split_rows

NONE = np.empty(0)
CLOSE = Knowledge(0.2, (True, True), NONE, NONE, 0.1)
OMEGA = 2 * np.pi * np.geomspace(10, 1000, 40)


@pytest.fixture(scope="module")
def fitted(experiment, datasheet, truth: dict[str, PlaneModel]):
    data = Data(plane_points(experiment.main, datasheet.axes, "x"))
    even = with_split(truth["x"], np.zeros(2))
    return refine(even, data, even.layout.free(), split=held_at_start(even, CLOSE))


def of(fitted, knowledge: Knowledge, use_data: bool = True):
    n = fitted.model.layout.n_modes
    r, j = fitted.fit.residual[:-n], fitted.fit.jacobian[:-n]
    return posterior(fitted.model, r, j, fitted.fit.free, knowledge, use_data)


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


def test_data_hold_one_combination_for_two_modes(fitted, truth: dict[str, PlaneModel]) -> None:
    flat = of(fitted, replace(CLOSE, closeness=None))
    ignorant = of(fitted, replace(CLOSE, closeness=None), use_data=False)
    with_data, without = (np.sqrt(np.linalg.eigvalsh(p.covariance)) for p in (flat, ignorant))
    assert with_data[0] < 0.3 * without[0]
    assert with_data[1] > 0.1 * without[1]


def test_closeness_finds_the_truth_of_a_rotor_whose_shape_changes_at_one_end_only(
    fitted, truth: dict[str, PlaneModel]
) -> None:
    found = of(fitted, CLOSE)
    assert np.allclose(found.log_ratios, log_ratios(truth["x"]), atol=0.15)
    std = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.log_ratios - log_ratios(truth["x"])) < 3 * std)


def test_the_datasheets_rotor_model_is_taken_at_its_tolerance(fitted, truth: dict[str, PlaneModel]) -> None:
    w = truth["x"].natural_frequencies
    known = Knowledge(0.08, (True, True), 1.01 * w, log_ratios(truth["x"]), 0.05)
    found = of(fitted, known, use_data=False)
    assert np.allclose(found.log_ratios, log_ratios(truth["x"]), atol=0.02)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), 0.05, rtol=0.2)
    far = Knowledge(0.08, (True, True), 1.5 * w, log_ratios(truth["x"]) + 1.0, 0.05)
    assert not np.allclose(of(fitted, far).log_ratios, far.log_ratios, atol=0.5)


@pytest.mark.parametrize("std", [1e-4, 1e-2, 0.2])
def test_knowledge_however_sharp_is_reproduced(fitted, std: float) -> None:
    w = fitted.model.natural_frequencies
    known = Knowledge(0.2, (True, True), w, np.array([0.4, -0.3]), std)
    found = of(fitted, known, use_data=False)
    assert np.allclose(np.sqrt(np.diag(found.covariance)), std, rtol=0.25)
    assert np.allclose(found.log_ratios, [0.4, -0.3], atol=0.35 * std + 1e-6)
