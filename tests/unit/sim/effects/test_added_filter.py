"""A filter in series with the controller is the one of the textbook, by Tustin's rule."""

import numpy as np
import pytest

from sim import control_law
from tests.unit.sim.effects.test_values import RIG, alone


def test_a_notch_that_the_datasheet_does_not_know_takes_gain_at_its_frequency_alone():
    """Half of it at 230 Hz, and of a low-pass filter nothing is left far above."""
    hz, own = np.array([2.0, 230.0, 4900.0]), {"filter_frequency_hz": 230.0, "filter_damping_ratio": 0.05}
    notch = alone("controller_mismatch", filter_mid_change=-0.5, **own)
    shares = control_law.response(notch.controller, 2 * np.pi * hz) / control_law.response(
        RIG.controller, 2 * np.pi * hz
    )
    np.testing.assert_allclose(np.abs(shares), [1.0, 0.5, 1.0], atol=2e-3)
    low = alone("controller_mismatch", filter_mid_change=-1.0, filter_high_change=-1.0, **own)
    passed = control_law.response(low.controller, 2 * np.pi * hz) / control_law.response(RIG.controller, 2 * np.pi * hz)
    w = 2e4 * np.tan(np.pi * hz / 1e4)  # by Tustin's rule
    s, at = 1j * w, 2 * np.pi * 230.0
    np.testing.assert_allclose(passed, at**2 / (s**2 + 2 * 0.05 * at * s + at**2), rtol=1e-9)


@pytest.mark.parametrize("times", [3.0, 0.4])
def test_a_lead_or_a_lag_is_a_filter_of_real_poles(times: float):
    """(s + t a)/(s + a), which multiplies what is integral by t, leaves the rest."""
    a, hz = 2 * np.pi * 3.0, np.array([1.0, 10.0, 300.0])
    zeta = 12.0
    w = a * (zeta + np.sqrt(zeta**2 - 1))  # poles at a and at w^2/a, where a zero cancels the second
    mid = (times * a + w**2 / a) / (2 * zeta * w) - 1
    own = {"filter_frequency_hz": w / (2 * np.pi), "filter_damping_ratio": zeta, "filter_mid_change": mid}
    changed = alone("controller_mismatch", filter_low_change=times - 1, **own).controller
    s = 2j * 1e4 * np.tan(np.pi * hz / 1e4)
    ratio = control_law.response(changed, 2 * np.pi * hz) / control_law.response(RIG.controller, 2 * np.pi * hz)
    np.testing.assert_allclose(ratio, (s + times * a) / (s + a), rtol=1e-5)
