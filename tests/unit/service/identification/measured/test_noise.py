"""Variances from few blocks."""

from __future__ import annotations

import numpy as np
import pytest

from service.identification.measured.noise import ROUNDED, block_noise

RNG = np.random.default_rng(3)
OMEGA = np.repeat(np.arange(80) + 1.0, 2)


def blocks(sd: np.ndarray, n_blocks: int = 6) -> np.ndarray:
    shape = (len(OMEGA), n_blocks, sd.shape[1])
    return (RNG.normal(size=shape) + 1j * RNG.normal(size=shape)) / np.sqrt(2) * sd[:, None, :]


def whitened_power(e: np.ndarray) -> float:
    model = block_noise(e, OMEGA)
    return float(np.mean(np.abs(np.einsum("pab,pb->pa", model.whitener(), e.mean(axis=1))) ** 2))


def test_equal_noise_is_pooled() -> None:
    e = blocks(np.ones((len(OMEGA), 4)) * [1, 2, 1e-6, 2e-6])
    model = block_noise(e, OMEGA)
    assert np.allclose(model.sigma * np.sqrt(6), [1, 2, 1e-6, 2e-6], rtol=0.35)
    assert np.std(model.sigma[:, 0]) < 0.12 * np.mean(model.sigma[:, 0])
    assert np.isinf(model.prior_blocks)


def test_block_lengths_that_change_from_point_to_point_are_followed() -> None:
    factor = np.repeat(RNG.choice([0.5, 1.0, 2.0], 80), 2)[:, None]
    powers = [whitened_power(blocks(factor * np.ones(4))) for _ in range(20)]
    assert np.mean(powers) == pytest.approx(1.05, abs=0.08)


def test_a_loud_point_keeps_its_own_variance() -> None:
    sd = np.exp(RNG.normal(size=(len(OMEGA), 1))) * np.ones(4)
    model = block_noise(blocks(sd), OMEGA)
    assert np.corrcoef(np.log(model.sigma[:, 0]), np.log(sd[:, 0]))[0, 1] > 0.9


def test_leakage_at_the_blocks_borders_does_not_count_in_full() -> None:
    # state differences at the borders: e_b = (s_b+1 - s_b) + n_b, so the mean hardly has them
    powers = []
    for _ in range(20):
        s = (RNG.normal(size=(len(OMEGA), 7, 2)) + 1j * RNG.normal(size=(len(OMEGA), 7, 2))) * 2
        powers.append(whitened_power(np.diff(s, axis=1) + blocks(np.ones((len(OMEGA), 2)))))
    assert np.mean(powers) == pytest.approx(1.0, abs=0.3)  # 0.25 were the correlation not seen


def test_correlated_channels_are_whitened() -> None:
    e = blocks(np.ones((len(OMEGA), 2)))
    e[:, :, 1] = 0.8 * e[:, :, 0] + 0.6 * e[:, :, 1]
    model = block_noise(e, OMEGA)
    correlation = model.covariance[:, 0, 1] / (model.sigma[:, 0] * model.sigma[:, 1])
    assert np.mean(correlation.real) == pytest.approx(0.8, abs=0.07)


def test_two_blocks_are_enough_to_go_on() -> None:
    assert np.all(np.isfinite(block_noise(blocks(np.ones((len(OMEGA), 4)), 2), OMEGA).sigma))


def test_blocks_that_still_drift_count_little_and_are_named() -> None:
    e = blocks(np.ones((len(OMEGA), 2)))
    usual = block_noise(e, OMEGA).sigma[40]
    e[40] += 20 * np.exp(1j * np.linspace(0, 1.5, 6))[:, None]
    model = block_noise(e, OMEGA)
    assert model.drifting[40]
    assert np.sum(model.drifting) == 1
    assert np.all(model.sigma[40] > 10 * usual)
    flagged = block_noise(e, OMEGA, suspect=np.arange(len(OMEGA)) == 7)
    assert flagged.drifting[[7, 40]].all()
    assert flagged.sigma[7, 0] > 3 * model.sigma[7, 0]


def test_noise_that_grows_with_the_signal_is_followed() -> None:
    size = np.exp(2 * RNG.normal(size=(len(OMEGA), 2)))
    model = block_noise(blocks(0.01 * size), OMEGA, magnitude=size)
    assert np.allclose(model.sigma * np.sqrt(6), 0.01 * size, rtol=0.4)


def test_blocks_of_unlike_length_are_told_from_what_rings_in_them() -> None:
    """White noise falls with a block's length, what rings with its square; without lengths a law mixes them up."""
    rng = np.random.default_rng(5)
    block_s = np.geomspace(0.2, 0.07, 400)[:, None]
    white = 0.1 / block_s
    ringing = 0.004 / block_s**2 * np.exp(np.sin(np.arange(400) / 20))[:, None]
    sd = np.sqrt((white + ringing) / 2)[:, None]
    e = sd * (rng.standard_normal((400, 6, 1)) + 1j * rng.standard_normal((400, 6, 1)))
    omega, size = np.linspace(1, 2, 400), np.ones((400, 1))
    told, untold = (
        block_noise(e, omega, False, size, rings=np.sqrt(ringing)[None], block_s=length)
        for length in (block_s[:, 0], None)
    )
    assert 6 * told.sigma**2 == pytest.approx(white, rel=0.2)
    assert np.max(abs(6 * untold.sigma**2 / white - 1)) > 0.3


def test_blocks_that_do_not_scatter_hang_together_with_nothing() -> None:
    """As those of a rig without noise, some of whose signals are the same to the last digit from block to block."""
    e = blocks(np.ones((len(OMEGA), 4)))
    e[:80, :, 2] = 0.0
    model = block_noise(e, OMEGA)
    assert np.isfinite(model.whitener()).all()
    assert np.isfinite(model.sigma).all()


@pytest.mark.parametrize("rings", [False, True])
def test_blocks_of_a_simulation_without_noise_scatter_by_rounding_at_least(rings: bool) -> None:
    """Beside no noise at all, whatever a model leaves would be beyond any number of deviations."""
    size = np.full((len(OMEGA), 2), 1e-6)
    residual = 1e-20 * blocks(np.ones((len(OMEGA), 2)))
    found = block_noise(residual, OMEGA, magnitude=size, rings=np.ones((1, *size.shape)) if rings else None)
    assert found.sigma == pytest.approx(ROUNDED * size / np.sqrt(6), rel=0.1, abs=0.0)
