"""Whatever a record is made of at harmonics 0 to 3, demodulation gives it back, block by block."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.experiment.demodulate import amplitudes, block_plan, demodulate

finite = st.floats(-10, 10)


def signal(values, ratio, n):
    """(n, 1) record of complex amplitudes at harmonics 0, 1, 2, 3."""
    k = np.arange(n)
    return sum((v * np.exp(2j * np.pi * h * ratio * k)).real for h, v in enumerate(values))[:, None]


@given(
    ratio=st.floats(0.002, 0.14),
    blocks=st.integers(1, 8),
    periods=st.floats(1.0, 9.0),
    parts=st.lists(finite, min_size=7, max_size=7),
)
def test_any_harmonic_content_is_recovered_at_any_frequency(ratio, blocks, periods, parts):
    values = [parts[0], *(complex(parts[2 * h - 1], parts[2 * h]) for h in (1, 2, 3))]
    n = max(int(np.ceil(blocks * periods / ratio)), 12 * blocks)
    plan = block_plan(n, ratio, blocks)
    found = amplitudes(signal(values, ratio, n), plan, ratio, (0, 1, 2, 3))
    assert found.shape == (blocks, 4, 1)
    np.testing.assert_allclose(found[:, :, 0], np.array([values] * blocks), atol=1e-6)


@given(n=st.integers(40, 5000), ratio=st.floats(0.003, 0.3), blocks=st.integers(1, 8))
def test_blocks_lie_in_the_record_end_with_it_and_hold_whole_periods(n, ratio, blocks):
    plan = block_plan(n, ratio, blocks)
    assert plan.start >= 0
    assert plan.start + plan.blocks * plan.samples == n
    if n * ratio >= blocks:
        periods = plan.samples * ratio
        assert abs(periods - round(periods)) <= ratio
        # no shorter than it could be: one more period would not fit in every block
        assert (round(periods) + 1) * blocks > n * ratio - 1e-5


@given(
    phase=st.floats(-3, 3),
    gain=st.complex_numbers(min_magnitude=0.01, max_magnitude=100, allow_nan=False),
    axis=st.integers(0, 3),
    frequency=st.floats(30, 900),
)
def test_the_excitation_is_real_and_positive_and_ratios_do_not_depend_on_the_time_origin(phase, gain, axis, frequency):
    ratio = frequency / 10_000
    k = np.arange(2000)
    wave = np.exp(1j * (2 * np.pi * ratio * k + phase))
    r = np.zeros((2000, 4))
    r[:, axis] = 0.3 * wave.real
    y = np.zeros((2000, 4))
    y[:, 1] = (0.3 * gain * wave).real
    out = demodulate({"r": r, "y": y}, frequency, 10_000, axis, blocks=3)
    first = out["r"][:, 1, axis]
    np.testing.assert_allclose(first, 0.3, rtol=1e-6)
    assert np.all(np.abs(first.imag) < 1e-9)
    np.testing.assert_allclose(out["y"][:, 1, 1] / first, gain, rtol=1e-6)


def test_a_harmonic_beyond_the_nyquist_frequency_is_zero_and_does_not_spoil_the_others():
    ratio = 0.3  # the second harmonic is at 0.6, the third at 0.9 of the sample rate
    found = amplitudes(signal([1.0, 2.0 - 1.0j], ratio, 400), block_plan(400, ratio, 4), ratio, (0, 1, 2, 3))
    np.testing.assert_allclose(found[:, :, 0], [[1.0, 2.0 - 1.0j, 0, 0]] * 4, atol=1e-9)


def test_too_short_a_record_is_refused():
    with pytest.raises(ValueError, match="fewer than 6 periods"):
        demodulate({"r": np.ones((500, 1))}, 100.0, 10_000, 0, blocks=6)
    with pytest.raises(ValueError, match="too short"):
        demodulate({"r": np.ones((24, 1))}, 4000.0, 10_000, 0, blocks=6)
