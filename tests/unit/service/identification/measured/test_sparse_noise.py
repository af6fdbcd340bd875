"""Noise of lines that stand far apart: a resonance raises the scatter of one line and not of its neighbours."""

import numpy as np

from service.identification.measured.noise import block_noise

LOUD = 40


def residual(seed, factor=3.0):
    """Blocks of 80 frequencies, two points each; one frequency scatters more."""
    rng = np.random.default_rng(seed)
    e = (rng.standard_normal((160, 10, 2)) + 1j * rng.standard_normal((160, 10, 2))) / np.sqrt(2)
    e[2 * LOUD : 2 * LOUD + 2] *= factor
    return e, np.repeat(np.arange(1.0, 81.0), 2)


def test_a_loud_line_keeps_its_own_variance_and_the_others_are_pooled():
    loud, quiet = [], []
    for seed in range(20):
        e, omega = residual(seed)
        sigma = block_noise(e, omega, correlated=False, sparse=True).sigma
        loud.append(sigma[2 * LOUD : 2 * LOUD + 2].mean())
        quiet.append(np.delete(sigma, [2 * LOUD, 2 * LOUD + 1], axis=0).std())
    assert 0.8 < np.mean(loud) * np.sqrt(10) / 3.0 < 1.2
    assert np.mean(quiet) < 0.15 / np.sqrt(10)


def test_without_being_told_it_is_taken_for_chance():
    e, omega = residual(1)
    as_chance = block_noise(e, omega, correlated=False).sigma[2 * LOUD].mean()
    own = block_noise(e, omega, correlated=False, sparse=True).sigma[2 * LOUD].mean()
    assert own > as_chance
