"""Multisines: their lines, the separation of the inputs, small peaks, and what detection lines tell."""

import numpy as np
import pytest

from service.campaign.multisine import crest, distortion
from service.experiment import multisine
from service.experiment.multisine import Lines, Multisine

RATE = 1000.0
SAMPLES = 1000


def lines(count=60, seed=1, avoid=()):
    return multisine.choose_lines(SAMPLES, RATE, 4.0, 200.0, count, np.random.default_rng(seed), avoid)


def random_multisine(found, n, seed=2):
    rng = np.random.default_rng(seed)
    return Multisine(found, (1 + np.arange(n)) * multisine.random_phases(len(found.excited), n, rng))


def test_lines_are_odd_within_the_band_and_one_of_every_four_is_left_out():
    found = lines()
    assert np.all(found.excited % 2 == 1)
    assert np.all(found.odd % 2 == 1)
    assert np.all(found.even % 2 == 0)
    assert found.excited[0] >= 4
    assert found.excited[-1] <= 200
    assert not set(found.excited) & set(found.odd)
    together = np.sort(np.concatenate([found.excited, found.odd]))
    assert len(together) == pytest.approx(60, abs=8)
    for start in range(0, len(together) - 3, 4):
        assert np.isin(together[start : start + 4], found.odd).sum() == 1


def test_lines_near_the_mains_are_not_used():
    found = lines(200, avoid=(50.9, 151.2))
    assert not {51, 151} & set(np.concatenate([found.excited, found.odd]))


def test_a_band_without_lines_is_refused():
    with pytest.raises(ValueError, match="lengthen the period"):
        multisine.choose_lines(100, RATE, 20.0, 60.0, 10, np.random.default_rng(1))


@pytest.mark.parametrize("seed", range(4))
def test_no_line_of_a_wanted_band_is_left_out_and_others_still_are(seed):
    samples, band = 8000, (150.0, 250.0)
    plain, found = (
        multisine.choose_lines(samples, RATE, 4.0, 400.0, 60, np.random.default_rng(seed), (), wanted)
        for wanted in ((), (band,))
    )
    step = RATE / samples
    hz = np.arange(1, samples // 2, 2) * step
    inside = hz[(hz >= band[0]) & (hz <= band[1])]
    assert len(inside) > 10
    assert set(np.round(inside / step)) <= set(found.excited)
    assert 0.5 * len(plain.odd) < len(found.odd) < len(plain.odd)
    assert not set(found.odd) & set(found.excited)
    far = found.excited[np.abs(found.excited * step - 200) > 51]
    assert set(far) <= set(plain.excited) | set(plain.odd)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6, 8])
def test_experiments_are_orthogonal(n):
    w = multisine.orthogonal(n)
    np.testing.assert_allclose(w @ w.conj().T, n * np.eye(n), atol=1e-12)
    np.testing.assert_allclose(np.abs(w), 1.0)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_the_separation_gives_every_input_as_if_it_had_been_alone(n):
    found = lines()
    m = random_multisine(found, n)
    rng = np.random.default_rng(3)
    G = rng.standard_normal((len(found.excited), n, n)) + 1j * rng.standard_normal((len(found.excited), n, n))
    X = np.array([np.einsum("lkj,lj->lk", G, m.experiment(e)) for e in range(n)])
    columns = multisine.separated(X, m)
    alone = np.swapaxes(G, 1, 2) * np.abs(m.spectrum)[:, :, None]
    np.testing.assert_allclose(columns, alone, atol=1e-12)


def test_the_separation_averages_noise_over_all_experiments():
    found = lines(200)
    m = random_multisine(found, 4)
    rng = np.random.default_rng(4)
    shape = (4, len(found.excited), 4)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    power = np.mean(np.abs(multisine.separated(noise, m)) ** 2)
    assert power == pytest.approx(2.0 / 4, rel=0.1)


def test_a_waveform_has_the_spectrum_that_was_asked_for_and_nothing_beside():
    m = random_multisine(lines(), 2)
    wave = m.waveform(1)
    both = multisine.spectra(np.vstack([wave, wave]), SAMPLES, np.arange(1, SAMPLES // 2))
    assert both.shape[0] == 2
    wanted = np.zeros_like(both[0])
    wanted[m.lines.excited - 1] = m.experiment(1)
    np.testing.assert_allclose(both[0], wanted, atol=1e-12)


def test_optimised_phases_have_smaller_peaks_than_random_ones():
    """For the displacements of a coupled plant, in all experiments at once."""
    found = lines(80)
    L = len(found.excited)
    f = found.frequency_hz(RATE)
    G = np.array([[1.0, 0.6], [0.5, 1.0]]) / (1 + 1j * f[:, None, None] / 30.0) ** 2
    a = np.ones((L, 2))
    random = [float(np.max(crest.predicted_peaks(random_multisine_flat(found, s), {"y": G})["y"])) for s in range(20)]
    m = crest.optimised(found, a, G, np.random.default_rng(5))
    pressed = float(np.max(crest.predicted_peaks(m, {"y": G})["y"]))
    np.testing.assert_allclose(np.abs(m.spectrum), a, rtol=1e-12)
    assert pressed < 0.75 * np.median(random)
    assert pressed < min(random)


def random_multisine_flat(found, seed):
    return Multisine(found, multisine.random_phases(len(found.excited), 2, np.random.default_rng(seed)))


def test_one_input_reaches_a_crest_factor_below_two():
    found = Lines(SAMPLES, np.arange(5, 165, 2), np.array([], dtype=int), np.array([], dtype=int))
    flat = np.ones((len(found.excited), 1))
    one = np.ones((len(found.excited), 1, 1), dtype=complex)
    m = crest.optimised(found, flat, one, np.random.default_rng(1))
    rms = np.sqrt(len(found.excited) / 2)
    assert np.max(crest.predicted_peaks(m, {"r": one})["r"]) < 2.0 * rms
    assert np.max(np.abs(m.waveform(0))) < 2.1 * rms  # between the samples of the search as well


def test_other_draws_give_other_realisations():
    found = lines()
    flat, G = np.ones((len(found.excited), 1)), np.ones((len(found.excited), 1, 1), dtype=complex)
    one, other = (crest.optimised(found, flat, G, np.random.default_rng(s), 20).spectrum for s in (1, 2))
    assert abs(np.vdot(one, other)) < 0.5 * len(found.excited)


# ---- detection lines


def levels_of(law, noise=1e-4, periods=4, seed=6):
    m = random_multisine(lines(), 1)
    x = m.waveform(0)
    x = x / np.sqrt(np.mean(x**2))
    rng = np.random.default_rng(seed)
    record = np.concatenate([law(x) + noise * rng.standard_normal(x.shape) for _ in range(periods)])
    both = np.concatenate([m.lines.excited, m.lines.detection])
    return distortion.levels(multisine.spectra(record, SAMPLES, both), m.lines)


def test_a_cubic_shows_at_odd_detection_lines_only():
    found = levels_of(lambda x: x + 0.01 * x**3)
    assert found.odd[0] > 20 * found.noise[0]
    assert found.even[0] < found.noise[0]
    # a cubic of random-phase lines puts about its own stochastic part at lines beside the excited ones
    assert 0.003 < found.odd[0] / found.signal[0] < 0.03


def test_a_square_shows_at_even_detection_lines_only():
    found = levels_of(lambda x: x + 0.01 * x**2)
    assert found.even[0] > 20 * found.noise[0]
    assert found.odd[0] < found.noise[0]


def test_noise_alone_is_no_distortion():
    for seed in range(10):
        found = levels_of(lambda x: x, noise=0.01, seed=seed)
        assert found.odd[0] < found.noise[0]
        assert found.even[0] < found.noise[0]
    assert found.noise[0] == pytest.approx(0.01 * np.sqrt(4 / SAMPLES / 4), rel=0.15)
    assert np.isneginf(found.in_decibels()["odd"][0]) or found.in_decibels()["odd"][0] < -40


def test_one_period_is_not_enough():
    with pytest.raises(ValueError, match="two"):
        levels_of(lambda x: x, periods=1)
