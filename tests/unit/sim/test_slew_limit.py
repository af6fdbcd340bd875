"""What a slew limit does to a tone beside the noise that reaches it."""

from dataclasses import replace

import numpy as np
import pytest

from sim import amplifier, slew_limit
from sim.effects import CATALOGUE
from sim.reference import reference_rig


@pytest.mark.parametrize("lag_s", [0.0, 4e-5])
def test_a_tone_that_noise_takes_to_the_limit_is_slowed_in_proportion_to_it(lag_s):
    """Small tones are known in closed form, larger ones by steps through time: at one between, both say the same."""
    plain = reference_rig()
    late = np.full(plain.n_axes, 1.3e-4)
    amp = replace(plain.amplifiers, damping_ratio=None, delay_s=late)
    rig = CATALOGUE["amplifier_voltage_limit"].on(
        replace(plain, amplifiers=replace(amp, lag_s=lag_s)), slope_noise_share=0.4
    )
    omega, period = 2 * np.pi * np.array([4.0, 60.0, 353.0]), rig.controller.sample_time_s
    reached = amplifier.sampled(amp, omega, period, np.zeros(rig.n_axes)) / amp.gain
    steepest = amp.natural_frequency_rad_s * np.abs(1 - reached)  # straight after a sample, of 1 A
    noise_a_per_s = 0.4 * rig.amplifiers.slew_limit_a_per_s

    def per_ampere(share):
        U = (share * noise_a_per_s / steepest)[:, None] * np.exp(0.3j)
        return [change / U for change in slew_limit.first_order(rig, omega[:, None], (1,), U)]

    for gentle, steep in zip(per_ampere(0.9 * slew_limit.GENTLE), per_ampere(1.1 * slew_limit.GENTLE), strict=True):
        assert np.all(np.abs(gentle) > 1e-5)
        np.testing.assert_allclose(gentle, steep, rtol=0.03)
