"""Noise spectra: the level of white noise, lines, and noise under a periodic signal."""

import numpy as np
import pytest

from service.campaign.noise import from_blocks, spectra, welch, without_mean_block

RATE = 10_000.0


def white(seed, n=30_000, std=1.0):
    return std * np.random.default_rng(seed).standard_normal((n, 2))


def records(y):
    return {"u": white(1), "i": white(2), "y": y}


def test_the_density_of_white_noise_is_twice_its_variance_over_the_rate():
    f, p = welch(white(0, std=3.0), RATE)
    assert p[5:-5].mean() == pytest.approx(2 * 9.0 / RATE, rel=0.03)
    assert f[-1] == RATE / 2


def test_the_variance_of_an_amplitude_is_what_blocks_scatter():
    noise = spectra(records(white(0, 300_000)), RATE)
    t = np.arange(1000)
    for f in (37.0, 500.0, 2000.0):
        blocks = white(5, 400_000).reshape(400, 1000, 2)
        amplitude = np.einsum("bta,t->ba", blocks, 2 / 1000 * np.exp(-2j * np.pi * f / RATE * t))
        measured = np.mean(np.abs(amplitude) ** 2, axis=0)
        np.testing.assert_allclose(noise.block_variance(f, 0.1)["y"], measured, rtol=0.25)


def test_a_line_is_found_and_leaks_into_a_short_block_beside_it():
    t = np.arange(30_000) / RATE
    y = white(0) + 2.0 * np.cos(2 * np.pi * 50 * t)[:, None]
    noise = spectra(records(y), RATE)
    assert any(abs(f - 50) <= 4 for f in noise.lines_hz)
    assert not [f for f in noise.lines_hz if abs(f - 50) > 6]
    # half a block's width away the sinc is 2/pi: |X|^2 = (2 * 2/pi)^2
    leaked = noise.block_variance(60.0, 0.05)["y"]
    np.testing.assert_allclose(leaked, (2 * 2 / np.pi) ** 2, rtol=0.2)
    # but a long block resolves the line, and far away it is not seen
    assert np.all(noise.block_variance(500.0, 0.05)["y"] < 0.02)


def test_white_noise_has_no_lines():
    assert spectra(records(white(0)), RATE).lines_hz == ()


def test_the_mean_block_takes_a_periodic_signal_away_and_leaves_the_noise():
    t = np.arange(6 * 500)
    signal = 100 * np.cos(2 * np.pi * 5 * t / 500) + 20 * np.cos(2 * np.pi * 15 * t / 500)
    noise = white(0, 3000)
    rest = without_mean_block(dict.fromkeys(("u", "i", "y"), signal[:, None] + noise), 500)
    assert rest["y"].std() == pytest.approx(1.0, rel=0.05)


def test_the_larger_of_two_spectra():
    quiet, loud = spectra(records(white(0)), RATE), spectra(records(white(3, std=2.0)), RATE)
    both = quiet.joined(loud)
    assert np.all(both.density["y"] >= quiet.density["y"])
    np.testing.assert_allclose(both.at(300.0)["y"], loud.at(300.0)["y"], rtol=0.01)


def test_spectra_from_unexcited_tones():
    rng = np.random.default_rng(0)
    f = np.array([10.0, 100.0, 1000.0])
    block = np.array([0.1, 0.1, 0.05])
    density = 3e-4
    std = np.sqrt(2 * density / block)[:, None, None]
    a = std * (rng.standard_normal((3, 500, 2)) + 1j * rng.standard_normal((3, 500, 2))) / np.sqrt(2)
    noise = from_blocks(f, dict.fromkeys(("u", "i", "y"), a), block)
    np.testing.assert_allclose(noise.at(300.0)["y"], density, rtol=0.2)
