"""The plane's model: derivatives, state space, force law, and agreement with the twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.identification.joint.refine import amplitude_of
from service.identification.plane.combine import (
    amplifier_state_space,
    plant_poles,
    plant_state_space,
    series,
    transmission_zeros,
)
from service.identification.plane.force_law import excess_force
from service.identification.plane.layout import Layout
from service.identification.plane.model import PlaneModel
from service.identification.plane.parameters import Known
from service.identification.plane.prediction import Amplitude, Points
from sim.reference import reference_rig
from sim.twin import linear_model
from tests.support.planes import plane_model_of

RNG = np.random.default_rng(0)
OMEGA = 2 * np.pi * np.geomspace(10, 1000, 25)
U = RNG.normal(size=(25, 2)) + 1j * RNG.normal(size=(25, 2))


@pytest.fixture
def model() -> PlaneModel:
    known = Known((0.418, 0.404), (0.484, 0.47), np.array([2.75, 2.5]), 1e-4, 2e-5, np.array([3e4, np.inf]))
    layout = Layout((2, 3), 2)
    theta = [181, 186, 1.68e6, 1.73e6, 1, 9244, 0.8068, 0.98, 9640, 0.83, 8e4, 1.3e-5]
    theta += [3095, 3.766, 0.0806, 0.0457, 0.08, 0.1416, 5700, 6.07, 0.21, -0.0827, 0.2, -0.0189]
    theta += [280, 10.87, 0.003, 1.01, 0.99, 0.002, -0.001]
    return PlaneModel(known, layout, np.array(theta))


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("octaves_up", [0, 2], ids=["low", "with aliases"])
def test_every_derivative_is_exact(model: PlaneModel, nonlinear: bool, octaves_up: int) -> None:
    points = Points(OMEGA[octaves_up * 8 :] * 2**octaves_up, U[octaves_up * 8 :])
    amplitude = Amplitude(0.5 * points.u, 1e-5 * points.u[::-1]) if nonlinear else None
    p = model.predict(points, amplitude, gradient=True)
    assert p.d_i is not None
    assert p.d_y is not None
    for k, name in enumerate(model.layout.names):
        size = max(abs(model.theta[k]) * (1e-4 if "sigma" in name else 1e-6), 1e-9)
        step = np.zeros_like(model.theta)
        step[k] = size
        up, down = (
            model.at(model.theta + step).predict(points, amplitude),
            model.at(model.theta - step).predict(points, amplitude),
        )
        for d, a, b in ((p.d_i, up.i, down.i), (p.d_y, up.y, down.y)):
            by_difference = (a - b) / (2 * size)
            assert np.max(np.abs(d[..., k] - by_difference)) <= 1e-5 * np.max(np.abs(by_difference)) + 1e-300, name


@pytest.mark.parametrize("plane", ["x", "y"])
def test_small_signal_response_is_the_twins(truth: dict[str, PlaneModel], plane: str) -> None:
    twin = linear_model(reference_rig(), OMEGA / (2 * np.pi))
    axes = slice(0, 2) if plane == "x" else slice(2, 4)
    # the twin also has the first images of the current in y: a few parts in a million
    g = twin.y_per_u[:, axes, axes]
    assert np.max(np.abs(truth[plane].response(OMEGA) - g) / np.linalg.norm(g, axis=(1, 2), keepdims=True)) < 1e-4
    assert np.allclose(
        truth[plane].amplifier_response(OMEGA, base_band=False), np.einsum("paa->pa", twin.i_per_u[:, axes, axes])
    )


def test_state_space_in_modal_form_has_the_models_response_and_poles(model: PlaneModel) -> None:
    no_sensor = PlaneModel(
        Known(model.known.bearing_from_cog_m, model.known.sensor_from_cog_m, model.known.bias_current_a, 1e-4),
        model.layout,
        model.theta,
    )
    ss = plant_state_space(no_sensor, ("xA", "xB"))
    assert np.allclose(ss.response(OMEGA), no_sensor.plant_response(OMEGA), rtol=1e-9)
    assert len(ss.states) == 8
    # block diagonal: real poles alone, pairs as [[-s, w], [-w, -s]]
    block = ss.A[4:6, 4:6]
    assert block[0, 1] == -block[1, 0] > 0
    assert block[0, 0] == block[1, 1] < 0
    assert np.count_nonzero(ss.A) == 4 + 4 * 2
    assert np.allclose(np.sort_complex(np.linalg.eigvals(ss.A)), np.sort_complex(plant_poles(no_sensor)), rtol=1e-6)


@pytest.mark.parametrize("first_order", [False, True], ids=["second order", "first order"])
def test_what_the_sampler_folds_onto_a_line_is_in_the_response(first_order: bool) -> None:
    """Up to 0.35 of the sample rate; without its aliases y would be off by 0.5 % at a fifth, and 7 % there."""
    rig = reference_rig()
    if first_order:
        rig = replace(rig, amplifiers=replace(rig.amplifiers, damping_ratio=None))
    hz = np.geomspace(300, 3500, 12)
    g = linear_model(rig, hz).y_per_u[:, :2, :2]
    model = plane_model_of(rig, "x")
    for found in (model.response(2 * np.pi * hz), _by_prediction(model, 2 * np.pi * hz)):
        off = np.linalg.norm(found - g, axis=(1, 2)) / np.linalg.norm(g, axis=(1, 2))
        assert np.all(off[hz < 2000] < (6e-4 if first_order else 1e-4))
        assert np.all(off < (6e-3 if first_order else 2e-3))


def _by_prediction(model: PlaneModel, omega: np.ndarray) -> np.ndarray:
    u = np.broadcast_to(np.eye(2, dtype=complex)[:, None], (2, len(omega), 2))
    return np.stack([model.predict(Points(omega, one)).y for one in u], axis=2)


@pytest.mark.parametrize("bandwidth_rad_s", [(3e4, np.inf), (np.inf, 2e4), (2e4, 2e4), (2e4, 2.5e4)])
def test_state_space_has_the_sensors_poles_as_the_model_has(model: PlaneModel, bandwidth_rad_s) -> None:
    slow = replace(model, known=replace(model.known, sensor_bandwidth_rad_s=np.array(bandwidth_rad_s)))
    ss = plant_state_space(slow, ("xA", "xB"))
    assert np.allclose(ss.response(OMEGA), slow.plant_response(OMEGA), rtol=1e-9, atol=0)
    poles = np.sort(np.linalg.eigvals(ss.A).real)
    sensors = -np.sort(np.array([w for w in bandwidth_rad_s if np.isfinite(w)]))[::-1]
    assert np.allclose(poles[: len(sensors)], sensors)
    assert len(ss.states) == len(ss.A) == 8 + len(sensors)
    at = [k for k, name in enumerate(ss.states) if name.startswith("sensor")]
    assert np.count_nonzero(ss.A[at]) == np.count_nonzero(ss.A[:, at]) == len(at)


def test_zeros_are_where_the_plant_loses_rank(truth: dict[str, PlaneModel]) -> None:
    for zero in transmission_zeros(truth["x"]):
        if abs(zero.imag) < 1:
            continue
        near = truth["x"].plant_response(np.array([abs(zero), 1.01 * abs(zero)]))
        at, off = (np.linalg.svd(g, compute_uv=False)[1] for g in near)
        assert at < 0.3 * off


def test_amplifiers_in_series_with_the_plant(truth: dict[str, PlaneModel]) -> None:
    model = truth["x"]
    amplifiers = amplifier_state_space(model, ("xA", "xB"))
    chain = series(amplifiers, plant_state_space(model, ("xA", "xB")))
    w = OMEGA[:5]
    # no hold and no delay in the state space: at 10 to 20 Hz they are a quarter of a degree
    assert np.allclose(chain.response(w), model.plant_response(w) @ amplifiers.response(w))
    assert np.allclose(amplifiers.response(np.array([0.0]))[0], np.eye(2))


def test_excess_force_is_the_third_order_of_the_force_law() -> None:
    ki, ks, bias = np.array([181.0, 186.0]), np.array([1.68e6, 1.73e6]), np.array([2.75, 2.75])
    gap = bias * ki / ks
    a = 0.02 * (RNG.normal(size=(6, 2)) + 1j * RNG.normal(size=(6, 2)))
    b = 0.02 * (RNG.normal(size=(6, 2)) + 1j * RNG.normal(size=(6, 2)))

    def product(x, y, z):
        return (x * y * z.conj() + x * y.conj() * z + x.conj() * y * z) / 4

    third = ki * bias * (product(a, a, b) + 3 * product(a, b, b) + 2 * product(b, b, b))
    force, d_ki, d_ks = excess_force(ki, ks, bias, a * bias, b * gap)
    assert np.allclose(force, third, rtol=0.02, atol=1e-3 * np.abs(third).max())
    # exact derivatives, amplitudes held
    for d, index in ((d_ki, 0), (d_ks, 1)):
        step = [1e-5 * ki, 0 * ks] if index == 0 else [0 * ki, 1e-5 * ks]
        up = excess_force(ki + step[0], ks + step[1], bias, a * bias, b * gap)[0]
        down = excess_force(ki - step[0], ks - step[1], bias, a * bias, b * gap)[0]
        assert np.allclose(d, (up - down) / (2 * step[index]), rtol=1e-4, atol=1e-9 * np.abs(d).max())


def test_excess_force_vanishes_with_the_amplitude(truth: dict[str, PlaneModel]) -> None:
    model = truth["x"]
    for size in (1e-3, 1e-4):
        points = Points(OMEGA, size * U)
        linear, full = model.predict(points).y, model.predict(points, amplitude_of(model, points)).y
        assert np.max(np.abs(full - linear)) < 30 * size**2 * np.max(np.abs(linear))


@pytest.mark.parametrize(("per_sample", "physical"), [(1e12, True), (1e60, False)])
def test_an_amplifier_of_one_lag_may_be_fast_but_does_not_run_away(
    model: PlaneModel, per_sample: float, physical: bool
) -> None:
    """Where a delay stands for its lag its frequency has no end, until no step of the sampled loop is a number."""
    theta, start = model.theta, model.layout.delay
    lag = [1.0, per_sample / model.known.sample_time_s]
    layout = Layout((1, 1), model.layout.n_modes)
    fast = replace(model, layout=layout, theta=np.concatenate([theta[:4], lag, lag, theta[start:]]))
    assert fast.is_physical == physical
