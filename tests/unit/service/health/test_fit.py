"""The few tones of a check, fitted: what they cannot tell stays what a rotor can have."""

from dataclasses import replace

import numpy as np
import pytest

from service.health.fit import plane_now
from service.identification.fit import identify
from service.identification.result.saved import saved_planes
from tests.support.rotors import drawn_rig


def test_a_mode_beyond_the_band_keeps_a_damping_that_a_rotor_can_have():
    """No tone shows its peak: the last ones alone would have it grow in half of the checks."""
    rig = drawn_rig("light and stiff", np.random.default_rng(0).uniform)
    saved = saved_planes(identify(rig.experiment(3e-3, 0), rig.sheet).document(), rig.sheet)["x"]
    assert saved.rotor_modes == (0,)
    assert saved.beyond.tolist() == [False, True]
    width = saved.model.modes[0, 1] / (2 * np.pi)
    peak = saved.model.natural_frequencies[0] / (2 * np.pi) + width * np.array([-1, 0, 1])
    few = replace(rig, frequency_hz=np.unique(np.concatenate([np.geomspace(12, 990, 14), peak])))
    for seed in (100, 101):
        now = plane_now(saved, few.experiment(3e-3, seed))
        assert 5e-4 < now.model.damping_ratios[1] < 0.05
        assert now.model.damping_ratios[0] == pytest.approx(rig.model.damping_ratios[0], rel=0.02)
        assert np.allclose(now.model.ki, rig.model.ki, rtol=0.005)
        assert now.rms == pytest.approx(1.0, abs=0.15)
