"""Noise of the sensors is read from the scatter of blocks, whatever was excited and however loud."""

import numpy as np
import pytest

from service.gap.proposal.sensor_noise import SensorNoise, fed_back
from sim.twin import linear_model, with_effects
from tests.support.synthetic import known_datasheet, sweep, true_rig

RIG = true_rig(known_datasheet()[1])
LINES = np.geomspace(12.0, 900.0, 16)
OF_I, OF_Y = 2 * (2e-4) ** 2 * 0.1, 2 * (2e-9) ** 2 * 0.1
"""Of the synthetic sweep for one second: what its blocks of a tenth of one have, A^2 s and m^2 s."""


@pytest.mark.parametrize("amplitude", [0.05, 0.3])
def test_the_noise_is_found_at_any_amplitude(amplitude: float) -> None:
    noise = SensorNoise.of(sweep(RIG, LINES, amplitude, seed=2), RIG)
    i, y = noise.at(np.geomspace(20.0, 800.0, 9))
    assert np.median(i) == pytest.approx(OF_I, rel=0.2)
    assert np.median(y) == pytest.approx(OF_Y, rel=0.2)


def test_a_loop_s_spectra_are_the_noise_that_it_carries_round() -> None:
    noise = SensorNoise(np.array([10.0, 1000.0]), np.full((2, 4), OF_I), np.full((2, 4), OF_Y))
    spectra = noise.spectra(RIG, 5000.0)
    assert np.all(np.diff(spectra.frequency_hz) > 0)
    k = int(np.argmin(np.abs(spectra.frequency_hz - 200.0)))
    u, i, y = fed_back(linear_model(RIG, spectra.frequency_hz[[k]]))
    for signal, per_noise, own in (("u", u, 0.0), ("i", i, OF_I), ("y", y, 0.0)):
        variance = np.sum(np.abs(per_noise[0]) ** 2, axis=1) * OF_Y + own
        assert spectra.block_variance(200.0, 0.5)[signal] == pytest.approx(variance / 0.5, rel=1e-6)


@pytest.mark.parametrize("samples", [-2.0, 1.0])
def test_a_log_out_of_step_changes_no_loop(samples: float) -> None:
    """What runs in the loop, and what noise makes of it, is as loud as it is without the offset."""
    late = with_effects(RIG, {"logging_offset": {"samples": samples}})
    right, offset = (fed_back(linear_model(rig, LINES)) for rig in (RIG, late))
    for one, other in zip(right, offset, strict=True):
        np.testing.assert_allclose(np.abs(other), np.abs(one), rtol=1e-9)
