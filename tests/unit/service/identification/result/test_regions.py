"""Regions of poles and zeros, and correlations of figures: what rotors drawn from the reported covariance do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from service.distributions import chi2_above
from service.identification.loop.margins import sensitivity
from service.identification.plane.combine import plant_poles, transmission_zeros
from service.identification.plane.model import PlaneModel
from service.identification.result.commissioning import CommissioningResult, PlaneResult
from service.identification.result.parts import RootResult

DRAWS = 600
SMALL, TINY = 3e-3, 3e-4
"""Of the spread: the propagation is tested, not how straight a rotor's figures are. Shapes at bearings and sensors,
whose product is known, scatter by a tenth each, and drawn apart that product would not be."""


@pytest.fixture(scope="module")
def plane(result: CommissioningResult) -> PlaneResult:
    return result.planes["x"]


def _drawn(plane: PlaneResult, share: float) -> list[PlaneModel]:
    """Rotors as the reported covariance scatters them, by so small a share of it."""
    places = [plane.model.layout.index(name) for name in plane.parameter_names]
    rng = np.random.default_rng(1)
    models = []
    for step in share * rng.multivariate_normal(np.zeros(len(places)), plane.covariance, DRAWS):
        theta = plane.model.theta.copy()
        theta[places] += step
        models.append(plane.model.at(theta))
    return models


@pytest.fixture(scope="module")
def drawn(plane: PlaneResult) -> list[PlaneModel]:
    return _drawn(plane, SMALL)


def _moved(root: RootResult, of: Callable[[PlaneModel], np.ndarray], drawn: list[PlaneModel]) -> np.ndarray:
    """Where the drawn rotors have that root, (2, draws) real and imaginary part beside it."""
    every = (of(m) for m in drawn)
    away = np.array([at[np.argmin(np.abs(at - root.value))] for at in every]) - root.value
    return np.stack([away.real, away.imag])


def test_poles_lie_within_their_regions(plane: PlaneResult, drawn: list[PlaneModel]) -> None:
    pairs = [p for p in plane.poles if p.value.imag > 1.0]
    assert len(pairs) == 2
    for root in pairs:
        away = _moved(root, plant_poles, drawn) / SMALL
        inside = np.einsum("an,ab,bn->n", away, np.linalg.inv(root.covariance), away) < chi2_above(0.1, 2)
        assert np.mean(inside) == pytest.approx(0.9, abs=0.04)
        assert root.std == pytest.approx(np.sqrt(np.trace(root.covariance)))


def test_zeros_scatter_as_told(plane: PlaneResult, drawn: list[PlaneModel]) -> None:
    closer = _drawn(plane, TINY)
    pairs = [z for z in plane.zeros if z.value.imag > 1.0]
    assert len(pairs) == 2
    for root in pairs:
        real, imaginary = np.sqrt(np.diag(root.covariance))
        # the damping of a zero is told by a ten millionth of its size, which rounding would drown in smaller draws
        assert np.std(_moved(root, transmission_zeros, drawn)[0]) / SMALL == pytest.approx(real, rel=0.1)
        assert np.std(_moved(root, transmission_zeros, closer)[1]) / TINY == pytest.approx(imaginary, rel=0.1)


def test_correlations_are_those_of_the_figures(
    plane: PlaneResult, drawn: list[PlaneModel], controller: tuple[np.ndarray, np.ndarray]
) -> None:
    told = plane.correlations
    np.testing.assert_allclose(told.matrix, told.matrix.T, atol=1e-9)
    np.testing.assert_allclose(np.diag(told.matrix), 1.0)
    near = 2 * np.pi * plane.margins["A"].peak_hz * (1 + np.linspace(-1e-4, 1e-4, 101))
    peak = [np.abs(sensitivity(m, controller, near)[:, 0, 0]).max() for m in drawn]
    figures = {
        "ksA": [m.ks[0] for m in drawn],
        "kiB": [m.ki[1] for m in drawn],
        "natural frequency 1": [m.natural_frequencies.min() for m in drawn],
        "damping ratio 1": [m.damping_ratios[np.argmin(m.natural_frequencies)] for m in drawn],
        "sensitivity peak A": peak,
    }
    names = list(figures)
    seen = np.corrcoef(np.array(list(figures.values())))
    places = [told.names.index(n) for n in names]
    np.testing.assert_allclose(told.matrix[np.ix_(places, places)], seen, atol=0.12)


def test_the_inertia_is_told_with_what_it_goes_together_with(plane: PlaneResult) -> None:
    told = plane.extended["correlations"]
    names, matrix = told["names"], np.array(told["matrix"])
    assert set(names) == {*plane.correlations.names, "transverse inertia", "centre of gravity"}
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-9)
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    # a larger inertia asks for a larger moment of the forces, which are seen in proportion to it alone
    assert matrix[names.index("transverse inertia"), names.index("kiA")] > 0.2
