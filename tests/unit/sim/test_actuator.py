"""The force law, its linearisation, its cubic terms, and what load, saturation, iron and eddy currents do to it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim import actuator
from sim.effects import effect
from sim.errors import LevitationError
from sim.reference import reference_rig

RIG = reference_rig()
M = RIG.magnets
I0, S0, KI, KS = M.bias_current_a, M.gap_m, M.ki, M.ks
K = KI * S0**2 / (4 * I0)


def derivative(function, at: float, step: float) -> np.ndarray:
    """Fourth-order central difference."""
    return (function(at - 2 * step) - 8 * function(at - step) + 8 * function(at + step) - function(at + 2 * step)) / (
        12 * step
    )


def per_ampere(i=0.0, x=0.0, m=M) -> np.ndarray:
    return derivative(lambda v: actuator.force(m, np.full(4, v), np.full(4, x)), i, 1e-3)


def per_metre(i=0.0, x=0.0, m=M) -> np.ndarray:
    return derivative(lambda v: actuator.force(m, np.full(4, i), np.full(4, v)), x, 1e-8)


def test_the_factors_are_the_slopes_of_the_law_4k_i0_by_s0_squared_and_4k_i0_squared_by_s0_cubed():
    np.testing.assert_allclose(per_ampere(), 4 * K * I0 / S0**2, rtol=1e-9)
    np.testing.assert_allclose(per_metre(), 4 * K * I0**2 / S0**3, rtol=1e-9)
    np.testing.assert_allclose(per_ampere(), KI, rtol=1e-9)
    np.testing.assert_allclose(per_metre(), KS, rtol=1e-9)


def test_the_law_is_that_of_two_magnets_that_pull_against_each_other():
    i, x = np.array([0.7, -0.2, 1.1, 0.4]), np.array([3e-5, -2e-5, 1e-5, 6e-5])
    exact = 4 * K * (I0 * x + i * S0) * (I0 * S0 + i * x) / (S0**2 - x**2) ** 2
    np.testing.assert_allclose(actuator.force(M, i, x), exact, rtol=1e-12)


def test_a_centred_bearing_has_no_preferred_side():
    rng = np.random.default_rng(1)
    i, x = rng.uniform(-5, 5, (50, 4)), rng.uniform(-8e-5, 8e-5, (50, 4))
    np.testing.assert_allclose(actuator.force(M, -i, -x), -actuator.force(M, i, x), rtol=1e-12)


def test_a_coil_cannot_push():
    """Beyond the bias current one magnet is off and the force grows as that of the other alone."""
    i = np.full(4, 4.0)
    np.testing.assert_allclose(actuator.force(M, i, np.zeros(4)), K * (I0 + i) ** 2 / S0**2, rtol=1e-12)


def test_the_current_is_limited():
    beyond = actuator.force(M, np.full(4, 9.0), np.zeros(4))
    np.testing.assert_array_equal(beyond, actuator.force(M, np.full(4, M.current_limit_a), np.zeros(4)))


@pytest.mark.parametrize("xi", [0.05, 0.15, -0.3])
def test_off_centre_the_factors_follow_the_exact_law(xi):
    m = replace(M, offset_m=xi * S0)
    np.testing.assert_allclose(per_ampere(m=m), KI * (1 + xi**2) / (1 - xi**2) ** 2, rtol=1e-8)
    np.testing.assert_allclose(per_metre(m=m), KS * (1 + 3 * xi**2) / (1 - xi**2) ** 3, rtol=1e-7)
    point = actuator.operating_point(replace(RIG, magnets=m))
    np.testing.assert_allclose(point.ki, per_ampere(m=m), rtol=1e-6)
    np.testing.assert_allclose(point.ks, per_metre(m=m), rtol=1e-6)
    np.testing.assert_array_equal(point.current_a, 0.0)


def test_a_static_load_leaves_ki_and_raises_ks_by_the_square_of_its_current():
    point = actuator.operating_point(reference_rig(gravity_m_per_s2=4.0))
    assert np.all(point.current_a > 1.0)
    assert np.all(point.current_a < I0)
    np.testing.assert_allclose(point.ki, KI, rtol=1e-6)
    np.testing.assert_allclose(point.ks, KS * (1 + point.current_a**2 / I0**2), rtol=1e-6)


def test_the_weight_is_carried_whole():
    rig = reference_rig(gravity_m_per_s2=4.0)
    point = actuator.operating_point(rig)
    carried = actuator.force(rig.magnets, point.current_a, np.zeros(4))
    np.testing.assert_allclose(carried, -actuator.static_load(rig), rtol=1e-9)
    # Two planes at 45 degrees share the weight; the moments about the centre of gravity balance.
    assert np.hypot(carried[:2].sum(), carried[2:].sum()) == pytest.approx(280.0 * 4.0)
    assert carried[0] * 0.418 == pytest.approx(carried[1] * 0.404)


def test_magnets_that_pull_askew_still_carry_the_weight():
    rig = effect("magnetic_cross_coupling").on(reference_rig(gravity_m_per_s2=3.0), rotation_rad=0.1)
    point = actuator.operating_point(rig)
    pulled = actuator.force_rotation(rig) @ actuator.force(rig.magnets, point.current_a, np.zeros(4))
    np.testing.assert_allclose(pulled, -actuator.static_load(rig), rtol=1e-9)


def test_a_weight_beyond_the_magnets_is_refused_with_axis_force_and_limit():
    with pytest.raises(LevitationError, match=r"axis xA cannot carry \d+ N within 6 A; raise"):
        actuator.operating_point(reference_rig(gravity_m_per_s2=30.0))


@pytest.mark.parametrize("amplitude_m", [2e-6, 15e-6])
def test_the_describing_function_of_the_displacement_has_the_cubic_term_two_xi_squared(amplitude_m):
    """F = ks x (1 + 2 xi^2 + ..): of a sine, the fundamental grows by 3/2 xi^2, xi = amplitude / gap."""
    theta = 2 * np.pi * np.arange(256) / 256
    x = amplitude_m * np.cos(theta)[:, None] * np.ones(4)
    fundamental = 2 * np.mean(actuator.force(M, np.zeros(4), x) * np.cos(theta)[:, None], axis=0)
    xi = amplitude_m / S0
    np.testing.assert_allclose(fundamental / (KS * amplitude_m) - 1, 1.5 * xi**2, rtol=0.02)


def test_the_describing_function_of_current_and_displacement_has_the_mixed_cubic_terms():
    """f/(4k) = (i0 x + i s0)(i0 s0 + i x)/(s0^2 - x^2)^2, expanded to third order in i/i0 and x/s0."""
    theta = 2 * np.pi * np.arange(256) / 256
    a, b, lag = 0.15, 0.04, 2.4  # relative amplitudes of current and displacement
    c, xi = a * np.cos(theta)[:, None], b * np.cos(theta - lag)[:, None]
    cubic = c + xi + (c**2 * xi + c * xi**2) + 2 * xi**2 * (c + xi)
    scale = KI * I0
    f = actuator.force(M, c * I0, xi * S0) / scale
    wave = np.exp(-1j * theta)[:, None]
    found, expected = 2 * np.mean(f * wave, axis=0), 2 * np.mean(cubic * wave, axis=0)
    linear = 2 * np.mean((c + xi) * wave, axis=0)
    assert np.all(np.abs(found - expected) < 0.02 * np.abs(found - linear))


def test_saturation_is_the_hyperbolic_tangent_of_the_control_current():
    m = effect("magnetic_saturation").on(RIG, saturation_inverse_per_a=1 / 1.6).magnets
    i = np.array([0.1, 0.8, -1.6, 3.0])
    np.testing.assert_allclose(actuator.saturated(m, i), 1.6 * np.tanh(i / 1.6), rtol=1e-12)
    np.testing.assert_array_equal(actuator.saturated(M, i), i)


@pytest.mark.parametrize("amplitude_a", [0.1, 0.5, 1.2])
def test_the_plays_lag_by_the_angle_that_rayleigh_gives_in_proportion_to_amplitude(amplitude_a):
    m = effect("magnetic_hysteresis").on(RIG, loss_angle_rad=0.02).magnets
    alpha = actuator.rayleigh_coefficient(m)[0]
    strength, weights, half_widths = actuator.plays(m)
    plays, theta = np.zeros(len(half_widths)), 2 * np.pi * np.arange(2000) / 2000
    out = []
    for i in amplitude_a * np.cos(np.concatenate([theta, theta])):
        plays = np.clip(plays, i - half_widths, i + half_widths)
        out.append(i + 2 * strength[0] * plays @ weights)
    fundamental = 2 * np.mean(np.array(out[2000:]) * np.exp(-1j * theta)) / amplitude_a
    law = 1 + alpha * amplitude_a - 4j * alpha * amplitude_a / (3 * math.pi)
    assert fundamental == pytest.approx(law, abs=0.02 * abs(law - 1))
    if amplitude_a == 0.5:
        assert -np.angle(fundamental) == pytest.approx(0.02, rel=0.02), "the parameter is the loss angle at 0.5 A"


@pytest.mark.parametrize("free_share", [0.0, 0.9])
@pytest.mark.parametrize("time_constant_s", [1e-8, 1.5e-6, 3e-5])
def test_the_eddy_states_of_the_time_loop_are_the_half_order_law(time_constant_s, free_share):
    m = effect("eddy_currents").on(RIG, time_constant_s=time_constant_s, free_share=free_share).magnets
    omega = 2 * np.pi * np.geomspace(2.0, 3000.0, 50)
    poles, weights = actuator.eddy_states(time_constant_s, m.eddy_corner_rad_s, m.eddy_free_share)
    realised = sum(w / (1 + 1j * omega / p) for p, w in zip(poles, weights, strict=True))
    law = actuator.eddy_factor(m, omega)[:, 0]
    np.testing.assert_allclose(realised, law, rtol=2e-3)
    assert np.all(np.abs(np.diff(np.angle(law))) > 0)
