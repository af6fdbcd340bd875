"""The tone that a controller makes, and what its lock-in finds in it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.controller import Tone
from drivers.device.lockin import LockIn, cosine, quantised_amplitude, ramp_samples, smooth_step

TONE = Tone(axis=0, amplitude_a=1.0, periods=7, samples=500, blocks=3)


def test_harmonics_are_found_with_their_phases_and_without_leakage() -> None:
    k = np.arange(1500)
    w = 2 * np.pi * 7 / 500
    x = 0.5 + 2 * np.cos(w * k + 0.3) + 0.1 * np.cos(2 * w * k - 1.0) + 0.01 * np.cos(3 * w * k + 2.0)
    lockin = LockIn(TONE, signals=1)
    lockin.add(x[:, None])
    expected = [0.5, 2 * np.exp(0.3j), 0.1 * np.exp(-1j), 0.01 * np.exp(2j)]
    np.testing.assert_allclose(lockin.amplitudes[:, :, 0], [expected] * 3, atol=1e-12)


@given(st.lists(st.integers(1, 700), min_size=1, max_size=8))
def test_chunks_do_not_matter(cuts: list[int]) -> None:
    x = np.random.default_rng(1).normal(size=(1500, 2))
    whole, parts = LockIn(TONE, 2), LockIn(TONE, 2)
    whole.add(x)
    for chunk in np.split(x, sorted({min(c, 1500) for c in np.cumsum(cuts)})):
        parts.add(chunk)
    np.testing.assert_allclose(parts.amplitudes, whole.amplitudes, atol=1e-13)


def test_harmonic_above_half_the_sample_rate_is_zero_and_not_an_alias() -> None:
    tone = Tone(axis=0, amplitude_a=1.0, periods=200, samples=500, blocks=1)
    lockin = LockIn(tone, signals=1)
    lockin.add(cosine(tone, 0, 500)[:, None])
    np.testing.assert_allclose(lockin.amplitudes[0, :, 0], [0, 1, 0, 0], atol=1e-12)


def test_phase_stays_exact_over_hours() -> None:
    first = 500 * 10**9
    np.testing.assert_array_equal(cosine(TONE, first, 100), cosine(TONE, 0, 100))
    np.testing.assert_array_equal(cosine(TONE, -500, 500), cosine(TONE, 0, 500))


def test_ramp_has_no_jump() -> None:
    x = smooth_step(np.linspace(-0.1, 1.1, 1201))
    assert (x[0], x[-1]) == (0, 1)
    assert np.max(np.abs(np.diff(x))) < 0.002


@pytest.mark.parametrize(("periods", "seconds"), [(1, 0.25), (20, 0.1), (4000, 0.02)])
def test_ramp_lasts_two_periods_within_bounds(periods: int, seconds: float) -> None:
    tone = Tone(axis=0, amplitude_a=0.1, periods=periods, samples=10_000)
    assert ramp_samples(tone, 10_000.0) == pytest.approx(seconds * 10_000, abs=1)


def test_nothing_is_ramped_without_excitation() -> None:
    assert ramp_samples(Tone(axis=0, amplitude_a=0.4e-6, periods=1, samples=1000), 10_000.0) == 0


@given(st.floats(0, 100))
def test_amplitude_has_whole_microamperes(amplitude: float) -> None:
    played = quantised_amplitude(amplitude)
    assert abs(played - amplitude) <= 0.500001e-6
    assert quantised_amplitude(played) == played
