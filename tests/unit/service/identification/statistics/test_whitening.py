"""Residuals in units of their noise."""

import numpy as np
import pytest

from service.identification.statistics.whitening import whitener

RNG = np.random.default_rng(3)


def covariances(channels: int) -> np.ndarray:
    root = RNG.normal(size=(7, channels, channels)) + 1j * RNG.normal(size=(7, channels, channels))
    return root @ root.conj().transpose(0, 2, 1) + 0.1 * np.eye(channels)


@pytest.mark.parametrize("channels", [1, 2, 4])
def test_whitened_noise_has_unit_variance_in_either_part_and_no_correlation(channels: int) -> None:
    covariance = covariances(channels)
    white = whitener(covariance).applied(np.broadcast_to(np.eye(channels)[:, :, None], (channels, channels, 7)) + 0j)
    w = white.transpose(2, 1, 0)
    np.testing.assert_allclose(
        w @ covariance @ w.conj().transpose(0, 2, 1), np.broadcast_to(2 * np.eye(channels), w.shape), atol=1e-12
    )


def test_some_channels_add_what_they_would_add_among_all() -> None:
    white = whitener(covariances(4))
    values = RNG.normal(size=(3, 4, 7)) + 1j * RNG.normal(size=(3, 4, 7))
    parts = np.zeros_like(values)
    white.add(values[:, :2], 0, parts)
    white.add(values[:, 2:], 2, parts)
    np.testing.assert_allclose(parts, white.applied(values), rtol=1e-12)


def test_channels_that_share_no_noise_are_only_scaled() -> None:
    white = whitener(np.broadcast_to(np.diag([4.0, 9.0]), (5, 2, 2)).astype(complex))
    assert [(row, column) for row, column, _ in white.entries] == [(0, 0), (1, 1)]
    np.testing.assert_allclose(white.applied(np.ones((2, 5), complex))[:, 0], np.sqrt(2) / np.array([2.0, 3.0]))


def test_a_covariance_that_is_none_is_refused() -> None:
    bad = covariances(2)
    bad[3, 0, 1] = bad[3, 1, 0] = 10 * abs(bad[3]).max()
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        whitener(bad)
