"""Blocks of a settled point agree; a transient is seen; noise that excitation brings is not taken for one."""

import numpy as np
import pytest

from service.campaign.settling import agreement, longer, stationary, tolerable

B, N = 6, 5


def blocks(seed, transient=0.0, decay=0.5, turn=0.0, std=1.0):
    rng = np.random.default_rng(seed)
    noise = std * (rng.standard_normal((B, N)) + 1j * rng.standard_normal((B, N))) / np.sqrt(2)
    decaying = transient * (decay * np.exp(1j * turn)) ** np.arange(B)
    return 1000 + noise + decaying[:, None]


def judged(x, negligible=0.0):
    return agreement(x, np.ones(N), np.full(N, negligible))


def test_noise_alone_is_settled_but_for_the_stated_false_alarms():
    wrong = sum(not judged(blocks(k)).settled for k in range(2000))
    assert 2 <= wrong <= 50  # 1 %, for two tests that share it


@pytest.mark.parametrize("turn", [0.0, 2.0, np.pi])
def test_a_transient_is_seen(turn):
    seen = sum(not judged(blocks(k, transient=10.0, turn=turn)).settled for k in range(50))
    assert seen == 50


def test_a_drift_from_half_to_half_is_seen_where_the_scatter_is_that_of_noise():
    """What decays slowly moves all blocks of a half alike, by less than each of them scatters."""
    drift = 0.75 * np.sign(np.arange(B) - (B - 1) / 2)[:, None]
    found = [judged(blocks(k) + drift) for k in range(200)]
    assert np.mean([not f.settled for f in found]) > 0.85
    assert np.median([f.excess for f in found]) < 1.4


def test_a_change_that_does_not_matter_is_let_through():
    x = 1000 + np.linspace(-3, 3, B)[:, None] * np.ones((1, N)) + 0j
    assert not judged(x).settled
    assert judged(x, negligible=10.0).settled


def test_scatter_that_waiting_does_not_lower_is_stationary():
    loud, louder = judged(blocks(0, std=3.0)), judged(blocks(1, std=3.0))
    assert not loud.settled
    assert stationary(loud, louder)
    assert not tolerable(judged(blocks(2, std=10.0)))
    before, after = judged(blocks(0, transient=100.0)), judged(blocks(1, transient=10.0))
    assert not stationary(before, after)


def test_the_next_wait_follows_from_the_decay():
    tau = 0.2
    now = judged(blocks(0, transient=400 * np.exp(-0.3 / tau)))
    before = (0.0, judged(blocks(1, transient=400.0)))
    wait = longer(0.3, now, 0.1, before)
    remaining = 400 * np.exp(-wait / tau)
    assert 0.1 < remaining < 8
    assert wait > 0.3


def test_the_next_wait_is_longer_and_bounded():
    bad = judged(blocks(0, transient=1e6))
    assert longer(0.0, bad, 0.1, None) == pytest.approx(0.1)
    assert longer(1.0, bad, 0.1, None) == pytest.approx(2.0)
    worse = (0.5, judged(blocks(0, transient=1e6 + 1)))
    assert longer(1.0, bad, 0.1, worse) <= 4.0
