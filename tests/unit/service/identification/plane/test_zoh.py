"""The sampled-data algebra against brute force: a fine simulation, and sums over images."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.plane import amplifier
from service.identification.plane.zoh import discrete_response, hold, sampled_pole

T = 1e-4
OMEGA = 2 * np.pi * np.array([10.0, 240.0, 1000.0, 3100.0])


@pytest.mark.parametrize("delay", [0.0, 0.3 * T, 0.995 * T, 2.4 * T])
def test_held_pole_is_the_response_of_a_stepped_simulation(delay: float) -> None:
    pole, fine = -3000.0 + 1500.0j, 200
    n = 400
    shift = round(delay / T * fine)
    step = np.exp(pole * T / fine)
    z = np.exp(1j * OMEGA * T)
    # impulse response: one sample of u held, delayed, integrated exactly over each fine step
    impulse = np.zeros(n)
    impulse[0] = 1.0
    held = np.concatenate([np.zeros(shift), np.repeat(impulse, fine)])[: n * fine]
    state, response = 0j, []
    for k, value in enumerate(held):
        if k % fine == 0:
            response.append(state)
        state = step * state + (step - 1) / pole * value
    brute = np.array([np.sum(np.array(response) * w ** -np.arange(n)) for w in z])
    found, _, _ = sampled_pole(OMEGA, pole, delay, T)
    assert np.allclose(found, brute, rtol=1e-4)


@pytest.mark.parametrize("parameters", [(0.95, 6000.0), (1.0, 9244.0, 0.8068), (1.0, 9244.0, 1.3, 50000.0)])
@pytest.mark.parametrize("delay", [-0.4 * T, 0.02 * T, 0.35 * T, 1.2 * T])
def test_derivatives_of_the_amplifier_are_exact(parameters: tuple[float, ...], delay: float) -> None:
    theta = np.array([*parameters, delay])
    for of in (amplifier.base_band, amplifier.sampled):
        _, gradient = of(OMEGA, theta[:-1], theta[-1], T)
        for k in range(len(theta)):
            step = np.zeros_like(theta)
            step[k] = 1e-10 if k == len(theta) - 1 else 1e-6 * theta[k]
            up = of(OMEGA, (theta + step)[:-1], (theta + step)[-1], T)[0]
            down = of(OMEGA, (theta - step)[:-1], (theta - step)[-1], T)[0]
            assert np.allclose(gradient[:, k], (up - down) / (2 * step[k]), rtol=1e-5, atol=1e-9)


def test_sampled_current_is_the_sum_of_its_images() -> None:
    # Poisson: samples fold the spectrum of the held staircase; |k| <= 4000 leaves 1e-7
    parameters, delay = np.array([1.0, 9244.0, 0.8]), 0.4 * T
    total = np.zeros(len(OMEGA), dtype=complex)
    for k in range(-4000, 4001):
        w = OMEGA + 2 * np.pi * k / T
        total += amplifier.base_band(w, parameters, delay, T)[0]
    assert np.allclose(total, amplifier.sampled(OMEGA, parameters, delay, T)[0], rtol=1e-6)


def test_sampled_and_base_band_current_differ_at_one_kilohertz_as_they_should() -> None:
    w = np.array([2 * np.pi * 1000.0])
    parameters = np.array([1.0, 9244.0, 0.8068])
    ratio = amplifier.sampled(w, parameters, 0.0, T)[0] / amplifier.base_band(w, parameters, 0.0, T)[0]
    assert 0.001 < abs(ratio[0] - 1) < 0.01


def test_hold_at_low_frequency_is_half_a_sample_of_delay() -> None:
    w = np.array([10.0])
    assert np.allclose(hold(w, T), np.exp(-0.5j * w * T), rtol=1e-6)


def test_discrete_response_of_a_delay() -> None:
    assert np.allclose(discrete_response(np.array([0.0, 1.0]), np.array([1.0, 0.0]), OMEGA, T), np.exp(-1j * OMEGA * T))


def test_poles_of_each_order() -> None:
    assert amplifier.Amplifier((1.0, 500.0)).poles.tolist() == [-500.0]
    assert np.allclose(amplifier.Amplifier((1.0, 1000.0, 0.6)).poles, [-600 + 800j, -600 - 800j])
    assert amplifier.Amplifier((1.0, 1000.0, 0.6, 4000.0)).order == 3
    # critically damped: no partial fractions, yet a finite answer
    assert np.all(np.isfinite(amplifier.sampled(OMEGA, np.array([1.0, 9000.0, 1.0]), 0.0, T)[0]))
