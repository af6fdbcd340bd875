"""Orders of a plane's two amplifiers: what one delay for both tells of them that neither does by itself."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.plane import amplifier
from service.identification.steps.amplifier_fit import Channel, amplifier_fit, with_one_delay

PERIOD_S, DELAY_S, NOISE = 1e-4, 2e-5, 0.01
NOMINAL = (1.0, 2 * np.pi * 1500.0, 0.8)


def channel(parameters: tuple[float, ...], delay_s: float, seed: int) -> Channel:
    """An amplifier seen at 150 lines up to 1 kHz."""
    rng, omega = np.random.default_rng(seed), 2 * np.pi * np.geomspace(10, 1000, 150)
    u = np.full(len(omega), 0.1 + 0j)
    i = u * amplifier.sampled(omega, np.array(parameters), delay_s, PERIOD_S)[0]
    sigma = NOISE * np.abs(i)
    noise = sigma / np.sqrt(2) * (rng.normal(size=len(omega)) + 1j * rng.normal(size=len(omega)))
    return Channel(omega, u, i + noise, sigma, PERIOD_S, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_an_order_that_a_delay_of_its_own_would_spare_is_seen(seed: int) -> None:
    # fast and well damped: up to 1 kHz a lag of first order and some more delay are as good, but not the other's delay
    a = channel((1.0, 12000.0, 1.1), DELAY_S, seed)
    b = channel((1.0, 9000.0, 0.5), DELAY_S, seed + 100)
    alone = amplifier_fit(a, NOMINAL), amplifier_fit(b, NOMINAL)
    assert [f.order for f in alone] == [1, 2]
    found = with_one_delay((a, b), alone)
    assert [f.order for f in found] == [2, 2]
    assert [[e.chosen for e in f.evidence] for f in found] == [[False, True, False]] * 2
    assert found[0].parameters[1] == pytest.approx(12000.0, rel=0.2)


@pytest.mark.parametrize("seed", range(3))
def test_channels_whose_delays_agree_keep_their_orders(seed: int) -> None:
    a, b = channel((1.0, 5000.0), DELAY_S, seed), channel((1.0, 9000.0, 0.7), DELAY_S, seed + 100)
    found = with_one_delay((a, b), (amplifier_fit(a, NOMINAL), amplifier_fit(b, NOMINAL)))
    assert [f.order for f in found] == [1, 2]
