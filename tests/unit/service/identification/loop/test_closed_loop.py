"""The controller in the loop of the identified model."""

import numpy as np
import pytest
from scipy.signal import tf2ss

from service.identification.loop.closed_loop import controller_states
from sim.reference import pid_with_biquad


@pytest.mark.parametrize(
    ("numerator", "denominator"),
    [
        pid_with_biquad(),
        ([2.0, 1.0], [3.0, 1.0, 0.5]),
        ([0.0, 3.0, 1.0], [0.0, 4.0, 1.0]),
        ([1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]),
    ],
    ids=["reference", "strictly proper", "leading zeros", "direct"],
)
def test_a_controllers_states_are_those_of_its_canonical_form(numerator, denominator):
    numerator, denominator = np.array(numerator), np.array(denominator)
    expected = tf2ss(np.trim_zeros(numerator, "f"), np.trim_zeros(denominator, "f"))
    for own, one in zip(controller_states((numerator, denominator)), expected, strict=True):
        np.testing.assert_allclose(own, one, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("numerator", "gain"), [([3.0], 0.75), ([0.0], 0.0)])
def test_a_plain_gain_has_no_state(numerator, gain):
    a, b, c, d = controller_states((np.array(numerator), np.array([4.0])))
    assert (a.shape, b.shape, c.shape) == ((0, 0), (0, 1), (1, 0))
    np.testing.assert_array_equal(d, [[gain]])
