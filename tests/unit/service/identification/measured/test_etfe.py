"""Empirical transfer function estimates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.identification.measured.etfe import etfe
from service.identification.measured.points import plane_points
from service.identification.plane.model import PlaneModel
from sim.errors import AmbError
from tests.support.planes import synthetic_sweep


def test_two_by_two_within_its_own_confidence_regions(datasheet, controller, truth: dict[str, PlaneModel]) -> None:
    # so small that the force law's excess is below the noise
    sweep = synthetic_sweep(
        truth, datasheet.axes, controller, np.geomspace(12, 950, 60), 0.002, displacement_noise_m=2e-10, seed=3
    )
    g = etfe(plane_points(sweep, datasheet.axes, "y"), "u->y")
    outside = np.abs(g.value - truth["y"].response(g.omega)) > g.radius(0.99)
    assert g.value.shape == (60, 2, 2)
    assert np.mean(outside) < 0.05
    assert np.mean(np.abs(g.value - truth["y"].response(g.omega)) > g.radius(0.5)) > 0.35
    assert np.all(np.diff(g.omega) > 0)


def test_currents_are_diagonal_and_sampled(experiment, datasheet, truth: dict[str, PlaneModel]) -> None:
    points = plane_points(experiment.main, datasheet.axes, "x")
    a = etfe(points, "u->i")
    exact = truth["x"].amplifier_response(a.omega, base_band=False)
    assert np.allclose(np.einsum("faa->fa", a.value), exact, atol=6 * a.std.max())
    assert np.max(np.abs(a.value[:, 0, 1])) < 6 * a.std[:, 0, 1].max()


def test_more_experiments_than_inputs_are_averaged(experiment, datasheet) -> None:
    main = experiment.main
    twice = replace(
        main,
        **{
            k: np.concatenate([getattr(main, k)] * 2)
            for k in ("frequency_hz", "axis", "amplitude_a", "R", "U", "I", "Y")
        },
    )
    once = etfe(plane_points(main, datasheet.axes, "x"), "u->y")
    both = etfe(plane_points(twice, datasheet.axes, "x"), "u->y")
    assert np.allclose(once.value, both.value, rtol=1e-9)
    assert np.median(both.std / once.std) == pytest.approx(1 / np.sqrt(2), rel=0.1)


def test_a_sweep_without_currents_says_so(experiment, datasheet) -> None:
    blind = replace(experiment.main, I=None)
    with pytest.raises(AmbError, match="coil currents"):
        etfe(plane_points(blind, datasheet.axes, "x"), "u->i")


def test_frequencies_that_do_not_meet_are_refused(experiment, datasheet) -> None:
    main = experiment.main
    apart = replace(main, frequency_hz=main.frequency_hz * (1 + 0.01 * main.axis))
    with pytest.raises(AmbError, match="same frequency"):
        etfe(plane_points(apart, datasheet.axes, "x"), "u->y")
