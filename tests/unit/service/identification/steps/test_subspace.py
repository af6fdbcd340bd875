"""The black-box comparison: it must be a fair one."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.measured.etfe import FrequencyResponse
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult
from service.identification.steps.subspace import subspace

OMEGA = (
    2
    * np.pi
    * np.unique(np.concatenate([np.geomspace(10, 1000, 90), 493 + np.linspace(-5, 5, 9), 907 + np.linspace(-8, 8, 9)]))
)


def test_exact_data_give_the_exact_poles_unstable_ones_included(truth: dict[str, PlaneModel]) -> None:
    g = truth["x"].plant_response(OMEGA)
    model = subspace(FrequencyResponse(OMEGA, g, 1e-6 * np.abs(g)), 8)
    assert model.order == 8
    assert model.fit_percent.min() > 99.99
    poles = model.poles
    for expected in (230.4, 110.5, -230.4, -110.5):
        assert np.min(np.abs(poles - expected)) < 2e-3 * abs(expected)
    # the order shows as a gap
    assert model.singular_values[8] < 1e-4 * model.singular_values[7]


def test_noisy_data_still_give_a_good_fit(truth: dict[str, PlaneModel]) -> None:
    rng = np.random.default_rng(0)
    g = truth["x"].plant_response(OMEGA)
    std = 0.002 * np.abs(g)
    noisy = g + std * (rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape)) / np.sqrt(2)
    model = subspace(FrequencyResponse(OMEGA, noisy, std), 8)
    assert model.fit_percent.min() > 95
    assert np.min(np.abs(model.poles - (-3.766 + 3094.6j))) < 1.0


def test_it_stands_beside_the_physical_model_in_the_result(result: CommissioningResult) -> None:
    for plane in result.planes.values():
        assert plane.subspace.order == 8
        assert plane.subspace.fit_percent.min() > 90
        document = plane.document()["subspace"]
        assert len(document["poles_rad_s"]) == 8


def test_block_rows_can_be_given(truth: dict[str, PlaneModel]) -> None:
    g = truth["x"].plant_response(OMEGA)
    assert subspace(FrequencyResponse(OMEGA, g, 1e-6 * np.abs(g)), 8, block_rows=10).fit_percent.min() == pytest.approx(
        100, abs=0.01
    )
