"""Amplifiers under a held input against an independent discretisation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from sim import amplifier, control_law
from sim.reference import reference_rig
from sim.rig import Amplifiers, ControlLaw

T = 1e-4
OMEGA = 2 * np.pi * np.array([5.0, 90.0, 700.0, 2400.0, 4700.0])
SECOND = reference_rig().amplifiers


def of_order(order: int) -> Amplifiers:
    """First order, second order, or second order behind a first-order lag."""
    if order == 3:
        return replace(SECOND, lag_s=3e-5)
    return SECOND if order == 2 else replace(SECOND, damping_ratio=None, gain=np.array([1.0, 0.9, 1.1, 2.0]))


def transfer(a: Amplifiers, axis: int) -> tuple[list[float], list[float]]:
    w = a.natural_frequency_rad_s[axis]
    if a.damping_ratio is None:
        return [a.gain[axis] * w], [1.0, w]
    return [a.gain[axis] * w**2], np.polymul([1.0, 2 * a.damping_ratio[axis] * w, w**2], [a.lag_s, 1.0]).tolist()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_samples_of_a_held_input_are_those_of_scipys_zero_order_hold(order):
    a = of_order(order)
    found = amplifier.sampled(a, OMEGA, T, np.zeros(4))
    for axis in range(4):
        numerator, denominator, _ = signal.cont2discrete(transfer(a, axis), T)
        z = np.exp(1j * OMEGA * T)
        np.testing.assert_allclose(
            found[:, axis], np.polyval(numerator.ravel(), z) / np.polyval(denominator, z), rtol=1e-9
        )


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("damping", [0.3, 1.0, 1.7])
@pytest.mark.parametrize("delay_s", [0.0, 35e-6, 1e-4, 2.6e-4])
def test_a_delay_of_any_length_is_exact(order, damping, delay_s):
    """Against the sum over the aliases that sampling folds onto a frequency, 1/T sum G(w + k ws) hold(w + k ws)."""
    a = of_order(order)
    if order > 1:
        a = replace(a, damping_ratio=np.full(4, damping))
    k = np.arange(-4000, 4001)
    found = amplifier.sampled(a, OMEGA, T, np.full(4, delay_s))
    folded = OMEGA[:, None] + 2 * np.pi * k / T
    sums = np.zeros((len(OMEGA), 4), dtype=complex)
    for row, w in enumerate(folded):
        hold = amplifier.hold(w, T)[:, None]
        sums[row] = np.sum(amplifier.continuous(a, w) * hold * np.exp(-1j * w * delay_s)[:, None], axis=0)
    # The tail of the sum of a first-order lag falls as 1/k only in pairs; what is left is below this.
    np.testing.assert_allclose(found, sums, rtol=2e-4 if order == 1 else 1e-7)


def test_at_dc_a_held_input_passes_with_the_gain():
    np.testing.assert_allclose(
        amplifier.sampled(of_order(1), np.array([1e-3]), T, np.zeros(4))[0].real, of_order(1).gain
    )


def test_the_hold_is_flat_at_dc_and_nothing_at_the_sample_rate():
    hold = amplifier.hold(2 * np.pi * np.array([0.0, 1 / T]), T)
    assert hold[0] == 1.0
    assert abs(hold[1]) < 1e-15


def test_the_controllers_response_is_that_of_its_difference_equation():
    law = reference_rig().controller
    (b,), (a,) = control_law.transposed_forms(law, 1)
    _, exact = signal.freqz(b, a, worN=OMEGA * T)
    np.testing.assert_allclose(control_law.response(law, OMEGA), exact, rtol=1e-9)


def test_a_short_numerator_is_that_of_low_powers():
    """Highest power of z first: 3 z / (z^2 - 0.5) has one zero at the origin and a sample of delay."""
    law = ControlLaw(np.array([6.0, 0.0]), np.array([2.0, 0.0, -1.0]), T)
    (b,), (a,) = control_law.transposed_forms(law, 1)
    np.testing.assert_array_equal(b, [0.0, 3.0, 0.0])
    np.testing.assert_array_equal(a, [1.0, 0.0, -0.5])
    z = np.exp(1j * OMEGA * T)
    np.testing.assert_allclose(control_law.response(law, OMEGA), 3 * z / (z**2 - 0.5), rtol=1e-12)
