"""The turning rotor as the sampler sees it: lines above a tenth of the sample rate, where aliases count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.identification.plane.prediction import Amplitude, Points
from service.identification.rotating.model import RotatingModel
from service.identification.rotating.motion import TurningPoints
from service.identification.rotating.whirl import sampled, whirl
from sim.reference import pid_with_biquad
from tests.support.turning import rig_at, true_model

HZ = np.array([50.0, 300.0, 499.0, 600.0, 800.0, 1000.0])
OMEGA = 2 * np.pi * HZ
SAMPLE_TIME_S = 2e-4
SPEED = 300.0
EXACT = 1e-4
"""Relative error of the nearest two aliases for all of them."""


@pytest.fixture(scope="module")
def model() -> RotatingModel:
    """Of a rig that is sampled at 5 kHz."""
    rig = rig_at(SPEED)
    return true_model(replace(rig, controller=replace(rig.controller, sample_time_s=SAMPLE_TIME_S)))


def excited(axis: int, speed: float = SPEED) -> TurningPoints:
    """One axis at a time."""
    u = np.zeros((len(OMEGA), 4), dtype=complex)
    u[:, axis] = 0.1
    return TurningPoints(OMEGA, np.full(len(OMEGA), speed), u)


@pytest.mark.parametrize("speed", [0.0, SPEED])
def test_what_the_rotor_shows_is_what_its_sampled_loop_has(model: RotatingModel, speed: float) -> None:
    """The fit and the margins against the exact discretisation, of which the loop's poles are."""
    exact = sampled(model, speed).response(OMEGA, SAMPLE_TIME_S)
    size = np.linalg.norm(exact, axis=1)
    assert np.all(np.linalg.norm(model.response(OMEGA, speed) - exact, axis=1) < EXACT * size)
    for axis in range(4):
        points = excited(axis, speed)
        off = model.predict(points).y - exact[:, :, axis] * points.u[:, axis, None]
        assert np.all(np.linalg.norm(off, axis=1) < EXACT * 0.1 * size[:, axis])


def test_a_rotor_at_standstill_shows_what_its_planes_show(model: RotatingModel) -> None:
    """Also where the magnets are driven hard, and the force law adds to what they do."""
    displacement = np.full((len(OMEGA), 4), 3e-6 + 0j)
    for k, plane in enumerate(model.planes):
        own, points = slice(2 * k, 2 * k + 2), excited(2 * k, 0.0)
        both = [Amplitude(points.u[:, own], displacement[:, own]), Amplitude(points.u, displacement)]
        here = plane.predict(Points(OMEGA, points.u[:, own]), both[0])
        whole = model.predict(points, both[1])
        for given, told in ((here.y, whole.y), (here.i, whole.i), (here.x, whole.x), (here.coil, whole.coil)):
            assert np.all(np.abs(told[:, own] - given) < 1e-9 * np.linalg.norm(given, axis=1)[:, None])


def test_slopes_are_those_of_what_is_sampled(model: RotatingModel) -> None:
    rng = np.random.default_rng(0)
    u = 0.1 * (rng.normal(size=(len(OMEGA), 4)) + 1j * rng.normal(size=(len(OMEGA), 4)))
    points = TurningPoints(OMEGA, rng.choice([0.0, 150.0, SPEED], len(OMEGA)), u)
    amplitude = Amplitude(u, np.full_like(u, 3e-6))
    slopes = model.predict(points, amplitude, gradient=True).d_y
    assert slopes is not None
    for k, name in enumerate(model.layout.names):
        step = np.zeros(model.layout.size)
        step[k] = 1e-12 if name.endswith("delay_s") else 1e-6 * max(abs(model.theta[k]), 1e-3)
        up, down = (model.at(model.theta + d).predict(points, amplitude).y for d in (step, -step))
        numeric = (up - down) / (2 * step[k])
        # line by line: what is wrong at one above a tenth of the sample rate is small beside those below
        size = np.max(np.abs(numeric), axis=1, keepdims=True)
        assert np.all(np.abs(numeric - slopes[:, :, k]) <= 3e-4 * size + 1e-15), name


@pytest.mark.parametrize("below_s", [1e-12, 1e-7])
def test_a_delay_just_below_a_whole_sample_has_whirling_poles_with_deviations(
    model: RotatingModel, below_s: float
) -> None:
    """A step of the delay beyond it has one state more in each axis."""
    delayed = replace(model, known=tuple(replace(k, computing_delay_s=SAMPLE_TIME_S) for k in model.known))
    theta, free = model.theta.copy(), np.zeros(len(model.theta), dtype=bool)
    for own, layout in zip(model.layout.own, model.layout.planes, strict=True):
        theta[own.start + layout.delay] = -below_s
        free[own.start + layout.delay] = True
    b, a = (np.array(x) for x in pid_with_biquad())
    covariance = 1e-14 * np.eye(2)
    found, beside = (
        whirl(delayed.at(t), (b, a), SPEED, covariance, free, 2 * np.pi * 1000)
        for t in (theta, np.where(free, theta - 1e-6, theta))
    )
    assert np.all(np.isfinite(found.covariance))
    assert found.covariance == pytest.approx(beside.covariance, rel=0.1)
