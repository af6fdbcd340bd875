"""Whether a multisine has settled: one line that rings is enough to say no, noise alone hardly ever is."""

import numpy as np
import pytest

from service.campaign.settling import period_change

L, N = 150, 4


def noise(rng, scale=1.0):
    return scale * (rng.standard_normal((L, N)) + 1j * rng.standard_normal((L, N))) / np.sqrt(2)


def change(rng, transient=0.0, line=70, negligible=0.0):
    first, last = noise(rng), noise(rng)
    first[line] += transient
    return period_change(first, last, np.ones((L, N)), np.full(L, negligible))


def test_noise_alone_is_rarely_called_a_transient():
    rng = np.random.default_rng(1)
    assert np.mean([change(rng) > 1 for _ in range(2000)]) == pytest.approx(0.01, abs=0.007)


def test_a_single_line_that_rings_is_seen():
    rng = np.random.default_rng(2)
    assert all(change(rng, transient=6.0) > 1 for _ in range(100))


def test_what_does_not_matter_is_let_pass():
    rng = np.random.default_rng(3)
    assert all(change(rng, transient=6.0, negligible=10.0) < 1 for _ in range(100))
